"""Where on the default body the vertices of another body lie."""

from __future__ import annotations

import numpy as np
import torch
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree
from torch import Tensor

from soar.body.lbs import keypoints, pose_vertices
from soar.body.record import BodyModel
from soar.geometry.meshes import compact, subdivide, vertex_normals
from soar.geometry.rotations import axis_angle_to_matrix

_SMOOTHING = 0.1  # of the warp: keypoints that two bodies define a centimetre apart do not crease it
_NORMAL = 0.1  # metres that a unit difference of normals is worth in matching
_SUBDIVISIONS = 2  # of the default body's skin: points a centimetre apart on its trunk, and closer elsewhere


@torch.no_grad()
def places(body: BodyModel, default: BodyModel) -> Tensor:
    """(V, 3) what :meth:`BodyModel.places` is to give for ``body``.

    Both mean bodies take the canonical pose. A smooth warp carries the keypoints of one onto those of the other, and
    with them its skin; each vertex then lies at the nearest point of the default body's skin that looks the same way.
    """
    moved, normals, ours = _posed(body)
    skin, directions, theirs = _posed(default)
    both = (body.keypoint_valid & default.keypoint_valid).numpy()
    warp = RBFInterpolator(ours[both], theirs[both], kernel="thin_plate_spline", smoothing=_SMOOTHING)
    faces, used = compact(default.faces.numpy(), ~default.interior.numpy())
    arrays = [x[used] for x in (skin, directions, default.places().double().numpy())]
    for _ in range(_SUBDIVISIONS):
        faces, *arrays = subdivide(faces, *arrays)
    skin, directions, rest = arrays
    _, nearest = cKDTree(np.hstack([skin, _NORMAL * directions])).query(np.hstack([warp(moved), _NORMAL * normals]))
    return torch.from_numpy(rest[nearest]).to(body.v_template)


def _posed(body: BodyModel) -> tuple[np.ndarray, ...]:
    """Vertices (V, 3), their normals and keypoints (137, 3) in the canonical pose: x left, y backward, z up."""
    axes = torch.stack([body.left, -body.front, body.up])
    betas = body.v_template.new_zeros(body.shapedirs.shape[-1])
    standing = (body, betas, axis_angle_to_matrix(body.canonical_pose), betas.new_zeros(3))
    vertices = pose_vertices(*standing)
    found = vertices, vertex_normals(vertices, body.faces), keypoints(*standing)
    return tuple((x @ axes.T).double().numpy() for x in found)
