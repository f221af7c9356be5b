"""What the stages that make or show avatars read: the body in motion, how it is rendered, and the training crops."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import read_npz
from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.metrics.image import white_crop_psnr
from soar.metrics.masked import iou
from soar.optimise.views import Views
from soar.raster import RasterSettings
from soar.report.pictures import spread
from soar.report.shots import Shot


@dataclasses.dataclass(frozen=True)
class Rig:
    """A body, its motion, and how an avatar that follows them is rendered."""

    body: BodyModel
    motion: BodyMotion
    raster: RasterSettings

    @staticmethod
    def read(inputs: Mapping[str, Path], cfg: Mapping[str, Any]) -> Rig:
        """From the inputs ``body_model`` and ``body``, and the node ``raster``."""
        raster = settings(RasterSettings, cfg["raster"], "raster")
        return Rig(BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"]), raster)

    @functools.cached_property
    def articulation(self) -> Articulation:
        """The motion as seen from the canonical pose."""
        return Articulation.of(self.body, self.motion)

    def puppet(self, avatar: Avatar) -> Puppet:
        """The avatar on this body's strings."""
        return Puppet(avatar, self.articulation, self.raster)


@dataclasses.dataclass(frozen=True)
class Observed(Rig):
    """A rig, and the training footage of the person it stands for."""

    views: list[Views]

    @staticmethod
    def read(inputs: Mapping[str, Path], cfg: Mapping[str, Any]) -> Observed:
        """With the training cameras' crops, and their normal maps where the stage has that input."""
        rig = Rig.read(inputs, cfg)
        views = []
        for name in Sequence.read(inputs["sequence"]).train:
            maps = read_npz(inputs["normals"] / f"{name}.npz") if "normals" in inputs else None
            views.append(Views.of(name, read_npz(inputs["crops"] / f"{name}.npz"), maps))
        return Observed(rig.body, rig.motion, rig.raster, views)

    def shots(self, avatar: Avatar, count: int) -> list[tuple[Views, int, Shot]]:
        """Renders of ``count`` crops, spread over every training camera's time."""
        puppet = self.puppet(avatar)
        return [(view, i, Shot.beside(view, i, puppet)) for view in self.views for i in spread(len(view), count)]


def agreement(shots: list[tuple[Views, int, Shot]]) -> tuple[float, float]:
    """Mean silhouette IoU, and mean PSNR of the whole crop on white in dB, of renders against their crops."""
    overlap, fidelity = [], []
    for view, i, shot in shots:
        truth, mask = view.image(i).permute(1, 2, 0).numpy(), view.mask(i).numpy()
        overlap.append(iou(shot.alpha, mask))
        fidelity.append(white_crop_psnr(shot.colour * shot.alpha[..., None], shot.alpha, truth, mask))
    return float(np.mean(overlap)), float(np.mean(fidelity))
