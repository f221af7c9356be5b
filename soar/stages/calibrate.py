"""Refine the cameras' rotations on the subject's joints; both calibrations are kept."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import write_image, write_json
from soar.body import pictures
from soar.body.calibrate import CalibrateSettings, Refinement, refine_rotations
from soar.body.observations import Observations
from soar.body.openpose import LIMBS
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.report.pictures import fit, grid
from soar.stages import Job
from soar.stages._subject import archives, observe

_MAGNIFY = 5.0  # of residuals on the evidence picture
_SPAN = 40.0  # pixels, half the width of the scatter
_CELL = 480


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the refined and the given cameras with the residuals they leave, and a picture of the residuals."""
    sequence = Sequence.read(inputs["sequence"])
    options = settings(CalibrateSettings, cfg["calibrate"], "calibrate")
    seen = observe(inputs, sequence.cameras, options.min_confidence)
    refinement = refine_rotations(seen, options)
    write_json(outputs["calibration"], _record(refinement))
    write_image(outputs["evidence"], _sheet(refinement, seen, sequence, inputs["frames"]))
    _health(refinement).write(outputs["health"])


def _record(refinement: Refinement) -> dict[str, Any]:
    return {
        "cameras": [camera.to_json() for camera in refinement.cameras],
        "original": [camera.to_json() for camera in refinement.original],
        "applied": refinement.applied,
        "remark": refinement.remark,
        "residual_px": {
            "linear": _number(refinement.linear),
            "robust_before": _number(refinement.before),
            "robust_after": _number(refinement.after),
            "per_camera_before": {k: _number(v) for k, v in refinement.per_camera(refinement.residual_before).items()},
            "per_camera_after": {k: _number(v) for k, v in refinement.per_camera(refinement.residual_after).items()},
        },
    }


def _number(value: float) -> float | None:
    """JSON has no NaN: a residual that cannot be had is null."""
    return value if np.isfinite(value) else None


def _sheet(refinement: Refinement, seen: Observations, sequence: Sequence, folder: Path) -> np.ndarray:
    frames = archives(folder, sequence.names, len(sequence))
    t = len(sequence) // 2
    cells, labels = [], []
    before, after = (refinement.per_camera(r) for r in (refinement.residual_before, refinement.residual_after))
    for c, camera in enumerate(refinement.cameras):
        image = frames[camera.name][t]
        points = np.where(seen.confidence[c, t, LIMBS, None] > 0, seen.points[c, t, LIMBS], np.nan)
        pair = refinement.residual_before[c], refinement.residual_after[c]
        drawn = pictures.draw_residuals(image, points, [r[t] for r in pair], _MAGNIFY)
        crop = drawn[pictures.window(points, image.shape[:2], 0.2)]
        cells += [fit(crop, _CELL, _CELL, 0.0), pictures.scatter(pair, _CELL, _SPAN)]
        labels += [
            f"{camera.name}  frame {sequence.frame_ids[t]}  residuals x {_MAGNIFY:g}",
            f"{camera.name}  all frames  median {before[camera.name]:.1f} (red) to {after[camera.name]:.1f} px (green)",
        ]
    return grid(cells, 4, labels)


def _health(refinement: Refinement) -> Health:
    health = Health("calibrate")
    health.add("residual_linear", refinement.linear, "px")
    health.add("residual_before", refinement.before, "px")
    health.add("residual_after", refinement.after, "px")
    after = refinement.per_camera(refinement.residual_after)
    for name, value in refinement.per_camera(refinement.residual_before).items():
        health.add(f"residual_before/{name}", value, "px")
        health.add(f"residual_after/{name}", after[name], "px")
    for camera, angle in zip(refinement.cameras, refinement.angles_deg, strict=True):
        health.add(f"turned/{camera.name}", angle, "degrees")
    health.remark(refinement.remark)
    return health
