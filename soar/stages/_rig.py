"""What the stages that make or show avatars read: the body in motion, how it is rendered, and the training crops."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import read_npz
from soar.avatar.articulate import Articulation, pose
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.losses.lpips import Lpips
from soar.metrics.image import white_crop_psnr
from soar.metrics.masked import iou
from soar.optimise.reconstruct import ReconstructSettings
from soar.optimise.views import Views
from soar.raster import Pinhole, RasterSettings, rasterise
from soar.report.orbit import Orbit
from soar.report.pictures import spread
from soar.report.shots import Shot

_FOV = 0.5  # radians, of pictures of the canonical pose
_MARGIN = 0.04  # free share of them on each side


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


def perceptual(inputs: Mapping[str, Path], options: ReconstructSettings) -> Lpips | None:
    """The perceptual distance of the training crops, if it has a weight."""
    if options.weights.lpips or options.weights.normal_lpips:
        return Lpips.load(inputs["models"] / f"lpips_{options.lpips}.safetensors", options.lpips)
    return None


def canonical_shots(rig: Rig, avatar: Avatar, count: int, height: int) -> list[Shot]:
    """The avatar in its canonical pose from ``count`` sides, front first, then its left; ``height`` in pixels."""
    body = rig.body
    orbit = Orbit.around(avatar.positions.numpy(), body.up.numpy(), body.front.numpy(), height, _FOV, _MARGIN)
    pinhole = Pinhole.from_K(orbit.K, orbit.width, orbit.height)
    one = torch.ones(len(avatar), 1)
    shots = []
    for k in range(count):
        T = torch.from_numpy(orbit.T_cam_from_world(k * 2 * np.pi / count)).float()
        positions, normals = pose(avatar.positions, avatar.normals, one, T[None, :3])
        surfels = (positions, normals, avatar.scales, avatar.colours, avatar.occlusion)
        shots.append(Shot.of(rasterise(*surfels, pinhole, side="front", settings=rig.raster)))
    return shots


def agreement(shots: list[tuple[Views, int, Shot]]) -> tuple[float, float]:
    """Mean silhouette IoU, and mean PSNR of the whole crop on white in dB, of renders against their crops."""
    overlap, fidelity = [], []
    for view, i, shot in shots:
        truth, mask = view.image(i).permute(1, 2, 0).numpy(), view.mask(i).numpy()
        overlap.append(iou(shot.alpha, mask))
        fidelity.append(white_crop_psnr(shot.colour * shot.alpha[..., None], shot.alpha, truth, mask))
    return float(np.mean(overlap)), float(np.mean(fidelity))
