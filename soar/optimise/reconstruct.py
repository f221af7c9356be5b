"""Reconstruction (paper, section 3.2): move surfels until every frame of the training cameras is explained."""

from __future__ import annotations

import dataclasses
from typing import Literal

import torch
from torch import Tensor

from soar.avatar.articulate import Articulation, pose
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar
from soar.losses.lpips import Lpips
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.descent import DescentSettings, Terms, descend
from soar.optimise.objective import Targets, Weights, image_terms, surface_terms
from soar.optimise.parameters import Surface
from soar.optimise.views import Views, epochs
from soar.raster import RasterSettings, rasterise_both


@dataclasses.dataclass(frozen=True)
class ReconstructSettings(DescentSettings):
    """The loop (``conf/reconstruct``)."""

    start: Literal["paint", "grey"]
    lpips: Literal["alex", "vgg"]
    weights: Weights
    mask_ramp: tuple[float, float]
    window_margin: int
    cache_mb: int


class Observation:
    """What the training crops ask of a surface: the terms of one crop at a time.

    Args:
        views: the training cameras.
        articulation: the body's motion; its frames are what ``views[k].frames`` index.
        lpips: the perceptual distance, None where its weights are zero.
        settings, raster: of the loop and the rasteriser.
    """

    def __init__(
        self,
        views: list[Views],
        articulation: Articulation,
        lpips: Lpips | None,
        settings: ReconstructSettings,
        raster: RasterSettings,
    ) -> None:
        self.views = [view.hardened(*settings.mask_ramp).tightened(settings.window_margin) for view in views]
        self.articulation, self.weights, self.raster = articulation, settings.weights, raster
        self.targets = Targets(self.views, lpips, settings.cache_mb)

    def terms(
        self,
        surface: Surface,
        attributes: tuple[Tensor, Tensor],
        blend: Tensor,
        ring: Tensor,
        view: int,
        index: int,
        background: Tensor,
    ) -> Terms:
        """The terms of crop ``index`` of camera ``view``, on ``background`` (3,), with their weights.

        ``attributes`` are the surface's; ``blend`` and ``ring`` as in :func:`~soar.optimise.descent.descend`.
        """
        crop, start = self.views[view], surface.start
        colours, scales = attributes
        transforms = self.articulation.in_camera(int(crop.frames[index]), crop.T_cam_from_world)
        positions, normals = pose(surface.positions, surface.normals, blend, transforms)
        surfels = (positions, normals, scales, colours, start.occlusion)
        front, back = rasterise_both(*surfels, crop.pinhole(index), settings=self.raster)
        terms = image_terms(front, back, self.targets, view, index, background, self.weights)
        terms |= surface_terms(surface.positions, scales, start, ring[:, 1:], self.weights)
        return {name: (getattr(self.weights, name), value) for name, value in terms.items()}


def reconstruct(
    start: Avatar,
    articulation: Articulation,
    left: Tensor,
    views: list[Views],
    lpips: Lpips | None,
    avatar: AvatarSettings,
    settings: ReconstructSettings,
    raster: RasterSettings,
    seed: int,
    checkpoint: Checkpoint,
) -> tuple[Avatar, dict[str, list[float]]]:
    """Optimise an avatar against the training crops, one crop a step.

    The order of the crops and the backgrounds are drawn before the first step, so a run that was killed and goes on
    from its checkpoint ends with the same bits as one that was not.

    Args:
        start: the first avatar.
        articulation: the body's motion; its frames are what ``views[k].frames`` index.
        left: (3,) unit vector from the body's right to its left in the canonical pose.
        views: the training cameras.
        lpips: the perceptual distance, None where its weights are zero.
        avatar, settings, raster: of the attributes, the loop and the rasteriser.
        seed: of the order, the backgrounds and the field's weights.
        checkpoint: where the state lives in between.

    Returns:
        the avatar, and the unweighted value of every term at every step.

    Raises:
        NumericalError: a term or a gradient is not finite; the state before that step is in the checkpoint.
    """
    observed = Observation(views, articulation, lpips, settings, raster)
    generator = torch.Generator().manual_seed(seed)
    surface = Surface(start, avatar, generator).to(start.positions.device)
    order = epochs(observed.views, settings.steps, generator)
    backgrounds = torch.rand(settings.steps, 3, generator=generator).to(start.positions)

    def look(step: int, blend: Tensor, ring: Tensor) -> Terms:
        return observed.terms(surface, surface.attributes(), blend, ring, *order[step], backgrounds[step])

    curves = descend("reconstruct", surface, articulation, left, settings, checkpoint, look)
    return surface.avatar(), curves
