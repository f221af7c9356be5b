"""What the stages that make avatars read: the body's motion, and the crops of the training cameras."""

from __future__ import annotations

import dataclasses
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
from soar.report.shots import Shot


@dataclasses.dataclass(frozen=True)
class Observed:
    """The training footage and the body that moves in it."""

    body: BodyModel
    motion: BodyMotion
    articulation: Articulation
    views: list[Views]
    raster: RasterSettings

    @staticmethod
    def read(inputs: Mapping[str, Path], cfg: Mapping[str, Any]) -> Observed:
        """Read the training cameras' crops, with normal maps where the stage has that input."""
        body, motion = BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"])
        views = []
        for name in Sequence.read(inputs["sequence"]).train:
            maps = read_npz(inputs["normals"] / f"{name}.npz") if "normals" in inputs else None
            views.append(Views.of(name, read_npz(inputs["crops"] / f"{name}.npz"), maps))
        return Observed(
            body, motion, Articulation.of(body, motion), views, settings(RasterSettings, cfg["raster"], "raster")
        )

    def puppet(self, avatar: Avatar) -> Puppet:
        """The avatar on this body's strings."""
        return Puppet(avatar, self.articulation, self.raster)

    def shots(self, avatar: Avatar, count: int) -> list[tuple[Views, int, Shot]]:
        """Renders of ``count`` crops, spread over every training camera's time."""
        puppet = self.puppet(avatar)
        return [
            (view, i, Shot.of(puppet.render(int(view.frames[i]), view.T_cam_from_world, view.pinhole(i))))
            for view in self.views
            for i in np.unique(np.linspace(0, len(view) - 1, count).round().astype(int)).tolist()
        ]


def agreement(shots: list[tuple[Views, int, Shot]]) -> tuple[float, float]:
    """Mean silhouette IoU, and mean PSNR of the whole crop on white in dB, of renders against their crops."""
    overlap, fidelity = [], []
    for view, i, shot in shots:
        truth, mask = view.image(i).permute(1, 2, 0).numpy(), view.mask(i).numpy()
        overlap.append(iou(shot.alpha, mask))
        fidelity.append(white_crop_psnr(shot.colour * shot.alpha[..., None], shot.alpha, truth, mask))
    return float(np.mean(overlap)), float(np.mean(fidelity))
