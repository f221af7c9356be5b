"""What the stages that look at finished avatars read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.raster import RasterSettings


def puppets(inputs: Mapping[str, Path], cfg: Mapping[str, Any], *names: str) -> list[Puppet]:
    """The avatars of the inputs called ``names``, on the strings of the input ``body``."""
    raster = settings(RasterSettings, cfg["raster"], "raster")
    articulation = Articulation.of(BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"]))
    return [Puppet(Avatar.read(inputs[name]), articulation, raster) for name in names]
