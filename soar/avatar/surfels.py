"""Oriented, opaque, round surfels in the canonical pose (paper, section 3.1), and their file."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from soar.artifacts import read_tensors, write_tensors
from soar.avatar.settings import AvatarSettings
from soar.body.lbs import pose_vertices
from soar.body.record import BodyModel
from soar.errors import ArtifactError
from soar.geometry.meshes import compact, edges, subdivide, vertex_normals
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_quaternion, orthonormal_frame, quaternion_to_matrix

LAYOUT = "soar-avatar-1"
SCALE_RANGE = (1e-4, 3e-2)
"""Radii in metres that a surfel may have, at the start and during optimisation."""


@dataclasses.dataclass(frozen=True)
class Avatar:
    """N surfels in the canonical pose.

    Attributes:
        positions: (N, 3) metres.
        quaternions: (N, 4) unit, w x y z; the normal is the rotation's third column. The other two columns are a
            gauge: a round disk looks the same however it is turned in its plane.
        scales: (N,) standard deviation of the disk, metres.
        colours: (N, 3) sRGB in [0, 1].
        occlusion: (N,) tau in [0, 1]; 1 = never seen.
        rest_positions: (N, 3) where the body mesh put the surfel, metres.
        neighbours: number of nearest body vertices whose skinning weights a surfel blends.
    """

    positions: Tensor
    quaternions: Tensor
    scales: Tensor
    colours: Tensor
    occlusion: Tensor
    rest_positions: Tensor
    neighbours: int

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def normals(self) -> Tensor:
        """(N, 3) outward unit normals."""
        return quaternion_to_matrix(self.quaternions)[..., 2]

    def replace(self, **changes: Tensor) -> Avatar:
        """A copy with some fields changed; ``normals=`` sets the quaternions."""
        if "normals" in changes:
            changes["quaternions"] = matrix_to_quaternion(orthonormal_frame(changes.pop("normals")))
        return dataclasses.replace(self, **changes)

    def to(self, *args, **kwargs) -> Avatar:
        """Move or cast every tensor, as ``Tensor.to`` does."""
        return dataclasses.replace(self, **{name: getattr(self, name).to(*args, **kwargs) for name in _SHAPES})

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write ``avatar.safetensors``, float32."""
        tensors = {name: getattr(self, name).float() for name in _SHAPES}
        # One key: the library writes several in a random order, and equal avatars shall be equal bytes.
        write_tensors(path, tensors, {"format": f"{LAYOUT} neighbours={self.neighbours}"})

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Avatar:
        """Read ``avatar.safetensors``.

        Raises:
            ArtifactError: the file is missing, truncated, or does not hold N surfels in this layout.
        """
        tensors, metadata = read_tensors(path)
        count = len(tensors["positions"]) if "positions" in tensors else 0
        expected = {name: (count, *tail) for name, tail in _SHAPES.items()}
        got = {name: tuple(value.shape) for name, value in tensors.items()}
        layout, _, neighbours = metadata.get("format", "").partition(" neighbours=")
        if layout != LAYOUT or not neighbours.isdigit() or got != expected or not count:
            raise ArtifactError(
                f"{path} is not an avatar of this version",
                expected=f"{LAYOUT}, {expected}",
                got=f"{metadata.get('format')}, {got}",
                cure="delete the file and run snakemake; it is made again",
            )
        return Avatar(**tensors, neighbours=int(neighbours))


_SHAPES: dict[str, tuple[int, ...]] = {
    "positions": (3,),
    "quaternions": (4,),
    "scales": (),
    "colours": (3,),
    "occlusion": (),
    "rest_positions": (3,),
}


def canonical_vertices(body: BodyModel, betas: Tensor) -> Tensor:
    """Body vertices (V, 3), metres, of shape ``betas`` (B,) in the canonical pose (arms and legs spread)."""
    rotations = axis_angle_to_matrix(body.canonical_pose)
    return pose_vertices(body, betas, rotations, betas.new_zeros(3))


def nearest(points: Tensor, queries: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Distances and indices, (Q, count), nearest first, of the ``points`` (P, 3) next to each of ``queries`` (Q, 3)."""
    tree = cKDTree(points.detach().cpu().numpy())
    distances, indices = tree.query(queries.detach().cpu().numpy(), k=range(1, count + 1))
    return torch.from_numpy(distances).to(queries), torch.from_numpy(indices).to(queries.device)


def from_body(body: BodyModel, betas: Tensor, settings: AvatarSettings) -> Avatar:
    """One grey, never seen surfel per vertex of the subdivided body surface in the canonical pose.

    Body meshes are coarse on the trunk: an edge longer than ``settings.longest_edge`` gets a surfel in its middle.
    Faces that no camera can see (mouth and eye cavities) are left out. The radius is the mean distance to the nearest
    neighbours, so neighbouring disks overlap and the surface is closed.
    """
    vertices = canonical_vertices(body, betas)
    faces, used = compact(body.faces.cpu().numpy(), ~body.interior.cpu().numpy())
    normals = vertex_normals(vertices, body.faces[~body.interior])[used]
    arrays = [vertices[used].cpu().numpy(), normals.cpu().numpy()]
    for _ in range(settings.subdivisions):
        faces, *arrays = subdivide(faces, *arrays)
    pairs = edges(faces)
    ends = arrays[0][pairs]
    wide = pairs[np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) > settings.longest_edge]
    arrays = [np.concatenate([x, x[wide].mean(1)]) for x in arrays]
    positions, normals = (torch.from_numpy(a).to(vertices) for a in arrays)
    distances, _ = nearest(positions, positions, settings.scale_neighbours + 1)
    return Avatar(
        positions=positions,
        quaternions=matrix_to_quaternion(orthonormal_frame(torch.nn.functional.normalize(normals, dim=-1))),
        scales=distances[:, 1:].mean(1).clamp(*SCALE_RANGE),
        colours=torch.full_like(positions, 0.5),
        occlusion=torch.ones_like(positions[:, 0]),
        rest_positions=positions.clone(),
        neighbours=settings.neighbours,
    )
