"""Reconstruct the avatar from the training cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import write_image, write_json
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.health import Health
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.reconstruct import ReconstructSettings, reconstruct
from soar.report.pictures import composite, grid
from soar.stages import Job
from soar.stages._rig import Observed, agreement, perceptual
from soar.stages._state import state_key

_SHOWN = 4  # frames of each training camera on the evidence sheet
_JUDGED = 10  # frames of each training camera in the health numbers


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the avatar, the loss curves, a sheet of photographs beside renders and normals, and health."""
    options = settings(ReconstructSettings, cfg["reconstruct"], "reconstruct")
    observed = Observed.read(inputs, cfg)
    painted = Avatar.read(inputs["paint"])
    start = painted.replace(occlusion=torch.ones_like(painted.occlusion))
    if options.start == "grey":
        start = start.replace(colours=torch.full_like(start.colours, 0.5))
    checkpoint = Checkpoint(job.scratch / "state.pt", state_key(inputs, cfg, job), options.checkpoint_seconds)
    avatar, curves = reconstruct(
        start,
        observed.articulation,
        observed.body.left,
        observed.views,
        perceptual(inputs, options),
        settings(AvatarSettings, cfg["avatar"], "avatar"),
        options,
        observed.raster,
        job.seed,
        checkpoint,
    )
    avatar.write(outputs["avatar"])
    write_json(outputs["curves"], curves)
    write_image(outputs["evidence"], _sheet(observed, avatar))
    _health(observed, painted, avatar, curves).write(outputs["health"])


def _sheet(observed: Observed, avatar: Avatar) -> np.ndarray:
    pictures, labels = [], []
    for view, i, shot in observed.shots(avatar, _SHOWN):
        pictures += [composite(view.rgb[i], view.alpha[i]), shot.on_white(), shot.normals_on_white()]
        labels += [f"{view.camera}  crop {i}", "avatar", "normals"]
    return grid(pictures, 6, labels)


def _health(observed: Observed, painted: Avatar, avatar: Avatar, curves: Mapping[str, list[float]]) -> Health:
    health = Health("reconstruct")
    overlap, fidelity = agreement(observed.shots(avatar, _JUDGED))
    before, _ = agreement(observed.shots(painted, _JUDGED))
    offset = (avatar.positions - avatar.rest_positions).norm(dim=-1) * 1000
    tenth = max(len(next(iter(curves.values()))) // 10, 1)
    health.add("iou", overlap)
    health.add("iou_gain", overlap - before)
    health.add("white_crop_psnr", fidelity, "dB")
    health.add("offset_median", float(offset.median()), "mm")
    health.add("offset_max", float(offset.max()), "mm")
    for name, curve in curves.items():
        health.add(f"{name}/last", float(np.mean(curve[-tenth:])))
    if overlap < before:
        health.remark("The silhouette agrees worse than the painted body's: look at the masks and the body fit.")
    return health
