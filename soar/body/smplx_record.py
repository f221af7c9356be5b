"""The body record of an SMPL-X file: what the pipeline fits, skins and draws instead of the default body."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch

from soar.body import openpose
from soar.body.canonical import vitruvian
from soar.body.correspondence import places
from soar.body.lbs import pose_vertices
from soar.body.record import BodyModel
from soar.body.regressor import MIDDLES, Row, fields, mean
from soar.body.smplx import EXTRA_VERTICES, LANDMARKS, OPENPOSE, SmplX
from soar.body.smplx_file import JOINTS, SmplxFile
from soar.body.visible import hidden
from soar.errors import ConfigError
from soar.geometry.rotations import axis_angle_to_matrix

UP, FRONT, LEFT = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)

# Stiffness of the joints a fit turns: the paper's 52, which is all but jaw and eyes. As in the default body; that has
# two joints in its back and none in its feet, so three share the bending here, and toes follow with reluctance.
_ACTIVE = {
    "pelvis": 0.0, "spine1": 3.0, "spine2": 3.0, "spine3": 3.0, "neck": 2.0, "head": 2.0, "{}_collar": 4.0,
    "{}_shoulder": 1.0, "{}_elbow": 1.0, "{}_wrist": 2.0, "{}_hip": 1.0, "{}_knee": 1.0, "{}_ankle": 2.0,
    "{}_foot": 4.0,
    **{f"{{}}_{finger}{k}": 2.0 for finger in ("index", "middle", "pinky", "ring", "thumb") for k in (1, 2, 3)},
}  # fmt: skip
_SIDES = ("left", "right")

# The hips that detectors report are wider apart than the hip joints: each lies farther out by this share of their
# distance (the paper's released code).
_HIPS_APART = 0.25


@dataclasses.dataclass(frozen=True)
class SmplxSettings:
    """Node ``body_model`` with the provider ``smplx``.

    Attributes:
        provider: ``smplx``.
        source: the user's model file.
        num_betas: shape components of the record, the first of the file.
        interior: ``hidden``: faces that are behind others from every side, such as the backs of the eyeballs, carry no
            surfels; ``none``: all faces do.
    """

    provider: Literal["smplx"]
    source: str | None
    num_betas: int
    interior: Literal["hidden", "none"]


def build_record(file: SmplxFile, default: BodyModel, settings: SmplxSettings) -> BodyModel:
    """The record, float32. It rests in T-pose with flat hands.

    Args:
        file: the model.
        default: the default body, on which the vertices are given their places.
        settings: how.

    Raises:
        ConfigError: the file has fewer shape components than asked for.
    """
    available = file.shapedirs.shape[-1]
    if not 1 <= settings.num_betas <= available:
        raise ConfigError(
            "body_model.num_betas: the SMPL-X file does not have so many", expected=f"1 to {available}",
            got=str(settings.num_betas),
        )  # fmt: skip
    model = SmplX.of(file, settings.num_betas, num_expression=0)
    stiffness = {JOINTS.index(pattern.format(side)): value for pattern, value in _ACTIVE.items() for side in _SIDES}
    arms, legs = (
        [(f"{side}_{a}", f"{side}_{b}", f"{side}_{c}") for side in _SIDES]
        for a, b, c in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
    )
    same = ("v_template", "shapedirs", "J_template", "J_shapedirs", "posedirs", "weights", "parents", "faces",
            "hand_mean", "hand_components")  # fmt: skip
    J = model.J_template.double().numpy()
    record = BodyModel(
        name="smplx",
        up=torch.tensor(UP),
        front=torch.tensor(FRONT),
        left=torch.tensor(LEFT),
        **{name: getattr(model, name) for name in same},
        joint_names=JOINTS,
        interior=torch.zeros(len(model.faces), dtype=torch.bool),
        **fields(keypoint_rows(model)),
        canonical_pose=torch.from_numpy(vitruvian(J, JOINTS, arms, legs, np.array(UP), np.array(LEFT))),
        active=torch.tensor(sorted(stiffness)),
        stiffness=torch.tensor([stiffness.get(j, 0.0) for j in range(len(JOINTS))]),
    )
    if settings.interior == "hidden":
        record = dataclasses.replace(record, interior=_hidden(record))
    return dataclasses.replace(record, place=places(record, default))


def keypoint_rows(model: SmplX) -> dict[str, Row]:
    """For each of OpenPose's keypoints but the pupils, which SMPL-X has no point for, its row of the regressor.

    The contour of the face is that of a head that looks straight ahead. Neck and hips are what detectors mean by them.
    """
    vertices = len(model.v_template)
    triangles = torch.cat([model.landmark_faces, model.contour_faces[0]])
    shares = torch.cat([model.landmark_barycentrics, model.contour_barycentrics[0]])
    points: list[Row] = [{vertices + joint: 1.0} for joint in range(len(JOINTS))]
    points += [{vertex: 1.0} for vertex in EXTRA_VERTICES]
    assert len(points) == LANDMARKS
    points += [
        dict(zip(corners, share, strict=True))
        for corners, share in zip(model.faces[triangles].tolist(), shares.tolist(), strict=True)
    ]
    rows = {name: points[k] for name, k in zip(openpose.NAMES, OPENPOSE, strict=False)}
    joints = {side: vertices + JOINTS.index(f"{side}_hip") for side in _SIDES}
    for side, other in (_SIDES, _SIDES[::-1]):
        rows[f"{side}_hip"] = {joints[side]: 1 + _HIPS_APART, joints[other]: -_HIPS_APART}
    for name, parts in MIDDLES.items():
        rows[name] = mean(rows[part] for part in parts)
    return rows


@torch.no_grad()
def _hidden(record: BodyModel) -> torch.Tensor:
    """(F,) bool: faces of the mean body that nobody sees in the canonical pose."""
    none = record.v_template.new_zeros(record.shapedirs.shape[-1])
    vertices = pose_vertices(record, none, axis_angle_to_matrix(record.canonical_pose), none.new_zeros(3))
    return torch.from_numpy(hidden(vertices.numpy(), record.faces.numpy()))
