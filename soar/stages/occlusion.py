"""tau: which surfels no training frame ever shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import write_image, write_json
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.health import Health
from soar.optimise.occlusion import OcclusionSettings, occlusion
from soar.report.pictures import grid
from soar.stages import Job
from soar.stages._rig import Observed, canonical_shots

_SIZE = 480  # pixels, height of each picture on the evidence sheet
_SIDES = ("front", "left", "back", "right")


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the avatar with tau, the body occlusion ratio, the avatar from four sides coloured by tau, and health."""
    options = settings(OcclusionSettings, cfg["occlusion"], "occlusion")
    observed = Observed.read(inputs, cfg)
    result = occlusion(
        Avatar.read(inputs["avatar"]), observed.articulation, observed.views, options, observed.raster, job.seed
    )
    result.avatar.write(outputs["avatar"])
    numbers = {"bor": result.bor, "bor_area": result.bor_area, "undecided": result.undecided}
    write_json(outputs["occlusion"], numbers)
    write_image(outputs["evidence"], _sheet(observed, result.avatar))
    health = Health("occlusion")
    for name, value in numbers.items():
        health.add(name, value)
    if result.undecided > 0.01:
        health.remark(
            f"{100 * result.undecided:.1f} % of the surfels are neither seen nor unseen: "
            "raise occlusion.steps or occlusion.visits."
        )
    health.write(outputs["health"])


def _sheet(observed: Observed, avatar: Avatar) -> np.ndarray:
    """The avatar in the canonical pose from four sides: photograph-like above, tau below; red was never seen."""
    shots = canonical_shots(observed, avatar, len(_SIDES), _SIZE)
    pictures = [shot.on_white() for shot in shots] + [shot.occlusion_on_white() for shot in shots]
    return grid(pictures, len(_SIDES), [*_SIDES, *("tau" for _ in _SIDES)])
