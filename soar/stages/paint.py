"""The baseline: the body painted with what the training cameras see of it, nothing optimised."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.artifacts import write_image
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import from_body
from soar.config import settings
from soar.health import Health
from soar.optimise.paint import PaintSettings, paint
from soar.report.pictures import composite, grid
from soar.stages import Job
from soar.stages._rig import Observed, agreement

_SHOWN = 4  # frames of each training camera on the evidence sheet, and in the health numbers


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the painted avatar, a sheet of photographs beside renders, and health."""
    options = settings(PaintSettings, cfg["paint"], "paint")
    observed = Observed.read(inputs, cfg)
    start = from_body(observed.body, observed.motion.betas, settings(AvatarSettings, cfg["avatar"], "avatar"))
    avatar, seen = paint(start, observed.articulation, observed.views, options, observed.raster)
    avatar.write(outputs["avatar"])
    shots = observed.shots(avatar, _SHOWN)
    pictures, labels = [], []
    for view, i, shot in shots:
        pictures += [composite(view.rgb[i], view.alpha[i]), shot.on_white()]
        labels += [f"{view.camera}  crop {i}", "paint"]
    write_image(outputs["evidence"], grid(pictures, 2 * _SHOWN, labels))
    overlap, fidelity = agreement(shots)
    health = Health("paint")
    health.add("surfels", len(avatar))
    health.add("seen", float(seen.double().mean()))
    health.add("iou", overlap)
    health.add("white_crop_psnr", fidelity, "dB")
    health.write(outputs["health"])
