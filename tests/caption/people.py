"""The whole small body of the tests, dressed, lit and photographed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch

from soar.body.lbs import pose_vertices
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT
from soar.body.parts import bones_of_vertices, without_side
from soar.body.record import BodyModel
from soar.caption.records import Footage, Sighting
from soar.raster import Pinhole, rasterise_mesh
from tests.body import stickman

Outfit = Callable[[str, float], tuple[int, int, int]]
"""sRGB of a place: large bone without its side, and share of the bone's own extent from its top, in [0, 1]."""

SKIN = (205, 150, 125)
_BONES = {
    "spine": "spine04", "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "shoulder": "upperarm01",
    "elbow": "lowerarm01",
}  # fmt: skip


def body() -> BodyModel:
    """The stickman with the bone names of the default body; its neck is a joint that moves no vertex."""
    model = stickman.body(torch.float32)
    names = []
    for name in model.joint_names:
        side, _, bone = name.rpartition("_")
        bone = _BONES.get(bone, bone)
        names.append("neck01" if name == "left_tip" else f"{bone}.{side[0].upper()}" if side else bone)
    return dataclasses.replace(model, joint_names=tuple(names))


def motion(model: BodyModel, frames: int) -> BodyMotion:
    """Standing, turned a little more to the left in every frame."""
    pose = torch.zeros(frames, len(model.joint_names), 3)
    pose[:, 0, 2] = torch.linspace(-0.3, 0.3, frames)
    ground = torch.tensor([0.0, 0.0, 0.9]).expand(frames, 3).clone()
    return BodyMotion(torch.zeros(2), pose, ground, torch.zeros(COUNT, 3))


def footage(outfit: Outfit, frames: int = 2, light: float = 1.0, rows: slice = slice(None)) -> Footage:
    """Photographs from the front.

    Args:
        outfit: what is worn.
        frames: how many photographs.
        light: factor of the light, which also falls from one side.
        rows: the part of the photographs that is kept.
    """
    model = body()
    moved = motion(model, frames)
    (camera,) = stickman.cameras(1)
    rotation, shift = torch.tensor(camera.R).float(), torch.tensor(camera.T_cam_from_world[:3, 3]).float()
    world = pose_vertices(model, moved.betas, moved.rotations, moved.translation)
    pinhole = Pinhole.from_K(np.diag([0.5, 0.5, 1]) @ camera.K, camera.width // 2, camera.height // 2)
    sightings = []
    for frame in range(frames):
        vertices = world[frame] @ rotation.T + shift
        rgb, alpha = _photograph(model, outfit, vertices, pinhole, light)
        top = rows.indices(pinhole.height)[0]
        rgb, alpha = np.ascontiguousarray(rgb[rows]), np.ascontiguousarray(alpha[rows])
        view = dataclasses.replace(pinhole, cy=pinhole.cy - top, height=len(rgb))
        sightings.append(Sighting("front", frame, rgb, alpha, vertices, view))
    return Footage("someone", model, tuple(sightings))


def _photograph(
    model: BodyModel, outfit: Outfit, vertices: torch.Tensor, pinhole: Pinhole, light: float
) -> tuple[np.ndarray, np.ndarray]:
    bones = np.array(bones_of_vertices(model))
    height = model.v_template.numpy() @ model.up.numpy()
    share = np.zeros(len(bones))
    for bone in set(bones.tolist()):
        mine = bones == bone
        share[mine] = (height[mine].max() - height[mine]) / np.ptp(height[mine])
    seen = rasterise_mesh(vertices, model.faces, pinhole, "front")
    on = (seen.face >= 0).numpy()
    corners, weights = model.faces[seen.face.long()].numpy()[on], seen.barycentrics.numpy()[on]
    main = corners[np.arange(len(corners)), weights.argmax(1)]
    worn = np.array(
        [outfit(without_side(bones[v]), float(s)) for v, s in zip(main, (share[corners] * weights).sum(1), strict=True)]
    )
    linear = (worn / 255) ** 2.2 * light * np.linspace(0.6, 1.2, pinhole.width)[np.nonzero(on)[1], None]
    rgb = np.full((pinhole.height, pinhole.width, 3), 90, np.uint8)
    rgb[on] = np.round(255 * linear.clip(0, 1) ** (1 / 2.2))
    return rgb, np.uint8(255 * on)
