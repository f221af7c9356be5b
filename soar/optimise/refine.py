"""Generative refinement (paper, section 3.3): what was never seen is completed by distilling a multi-view prior."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Generic

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from soar.avatar.articulate import Articulation, pose
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar
from soar.losses.regularise import curvature, normal_depth
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.descent import DescentSettings, Terms, descend
from soar.optimise.parameters import Surface
from soar.optimise.reconstruct import Observation
from soar.optimise.surround import Look, Surround, SurroundSettings
from soar.optimise.views import epochs
from soar.priors.protocol import Domain, MultiViewPrior, Prompt, Views
from soar.raster import RasterSettings, Rendered, rasterise


@dataclasses.dataclass(frozen=True)
class RefineWeights:
    """Of the terms of the four views; a term of weight 0 is not computed."""

    sds: float
    normal_depth: float
    curvature: float


@dataclasses.dataclass(frozen=True)
class PhaseSettings(DescentSettings):
    """One phase (nodes ``refine.shape`` and ``refine.texture``).

    Attributes:
        weights: see there; those of the training crops' terms are ``reconstruct.weights``.
        times: (least, most) noise, as shares of the prior's schedule, at the first step, and the same at the last; a
            step draws between limits that move evenly.
        seen: share of the prior's gradient that reaches a pixel the training cameras saw fully; 1 = no masking. In
            between it is ``seen ** (1 - tau)``.
    """

    weights: RefineWeights
    times: tuple[tuple[float, float], tuple[float, float]]
    seen: float


@dataclasses.dataclass(frozen=True)
class RefineSettings:
    """The stage (``conf/refine``)."""

    shape: PhaseSettings
    texture: PhaseSettings
    views: SurroundSettings


@dataclasses.dataclass(frozen=True)
class Guide(Generic[Prompt]):
    """What a phase distils.

    Attributes:
        prior: the model.
        prompts: by (view, index) of the training crops.
        surround: the cameras; their pictures are the prior's.
        domain: what is rendered: colours or normals.
    """

    prior: MultiViewPrior[Prompt]
    prompts: Mapping[tuple[int, int], Prompt]
    surround: Surround
    domain: Domain


def refine(
    name: str,
    start: Avatar,
    articulation: Articulation,
    left: Tensor,
    observed: Observation,
    guide: Guide[Any] | None,
    avatar: AvatarSettings,
    settings: PhaseSettings,
    raster: RasterSettings,
    seed: int,
    checkpoint: Checkpoint,
) -> tuple[Avatar, dict[str, list[float]]]:
    """One phase: the reconstruction's terms of one crop, and the prior's opinion of four views in the crop's pose.

    Everything random is drawn before the first step, so a run that was killed and goes on from its checkpoint ends with
    the same bits as one that was not.

    Args:
        name: of the phase, for messages.
        start: the avatar with tau.
        articulation: the body's motion.
        left: (3,) unit vector from the body's right to its left in the canonical pose.
        observed: the training crops.
        guide: what is distilled, or None for the reconstruction's terms alone.
        avatar: whether colour and radius are free or the field's; the field starts as a correction, zero, of those the
            avatar has, so that the phase begins with the very avatar it was given.
        settings, raster: of the phase and the rasteriser.
        seed: of everything random.
        checkpoint: where the state lives in between.

    Returns:
        the avatar, and the unweighted value of every term at every step that had it.

    Raises:
        NumericalError: a term, a gradient or the prior is not finite; the state before that step is in the checkpoint.
    """
    generator = torch.Generator().manual_seed(seed)
    correction = dataclasses.replace(avatar, field=dataclasses.replace(avatar.field, residual=True, prefit_steps=0))
    surface = Surface(start, correction, generator).to(start.positions.device)
    order = epochs(observed.views, settings.steps, generator)
    backgrounds = torch.rand(settings.steps, 3, generator=generator).to(start.positions)
    cameras = torch.rand(settings.steps, 4, generator=generator)
    times = _times(settings, torch.rand(settings.steps, generator=generator))
    noises = torch.randint(1 << 62, (settings.steps,), generator=generator).tolist()

    def look(step: int, blend: Tensor, ring: Tensor) -> Terms:
        view, index = order[step]
        attributes = surface.attributes()
        terms = observed.terms(surface, attributes, blend, ring, view, index, backgrounds[step])
        if guide is None:
            return terms
        crop = observed.views[view]
        frame = int(crop.frames[index])
        looks = guide.surround.looks(frame, crop.T_cam_from_world, cameras[step])
        renders = _renders(surface, attributes, blend, articulation.transforms[frame], looks, guide.surround, raster)
        shown = shots(renders, looks, guide, frame, settings.seen)
        noise = torch.Generator().manual_seed(noises[step])
        terms["sds"] = settings.weights.sds, guide.prior.loss(guide.prompts[view, index], shown, times[step], noise)
        for term, weight, values in (
            ("views_normal_depth", settings.weights.normal_depth, lambda: _normal_depths(renders, looks, guide)),
            ("views_curvature", settings.weights.curvature, lambda: [curvature(r.normal, r.alpha) for r in renders]),
        ):
            if weight:
                terms[term] = weight, torch.stack(values()).mean()
        return terms

    curves = descend(name, surface, articulation, left, settings, checkpoint, look)
    return surface.avatar(), curves


def shots(renders: Sequence[Rendered], looks: Sequence[Look], guide: Guide[Any], frame: int, seen: float) -> Views:
    """Renders as the prior wants them.

    Args:
        renders: of the four cameras at the resolution of :meth:`~soar.optimise.surround.Surround.fine`.
        looks: the cameras.
        guide: prior, cameras and domain.
        frame: of the motion.
        seen: see :class:`PhaseSettings`.
    """
    samples = guide.surround.settings.samples
    planes = avg_pool2d(torch.stack([rendered.planes for rendered in renders]), samples)
    colour, normal, _, alpha, occlusion = planes.split((3, 3, 1, 1, 1), 1)
    pictures = colour if guide.domain == "colour" else (normal + alpha) / 2
    if seen < 1:
        tau = (occlusion / alpha.clamp_min(1e-3)).detach().clamp(0, 1)
        weight = seen ** (1 - tau)
        pictures, alpha = (x.detach() + weight * (x - x.detach()) for x in (pictures, alpha))
    geometry = torch.stack([guide.surround.planes(frame, look.T_cam_from_world, look.pinhole) for look in looks])
    azimuth, elevation = (torch.tensor([getattr(look, what) for look in looks]) for what in ("azimuth", "elevation"))
    return Views(pictures, alpha, geometry.to(pictures), azimuth, elevation)


def _renders(
    surface: Surface,
    attributes: tuple[Tensor, Tensor],
    blend: Tensor,
    transforms: Tensor,
    looks: Sequence[Look],
    surround: Surround,
    raster: RasterSettings,
) -> list[Rendered]:
    """The surface in one pose, (B, 3, 4) world from canonical, through the four cameras."""
    colours, scales = attributes
    positions, normals = pose(surface.positions, surface.normals, blend, transforms)
    rendered = []
    for look in looks:
        R, t = look.T_cam_from_world[:3, :3].to(positions), look.T_cam_from_world[:3, 3].to(positions)
        surfels = (positions @ R.T + t, normals @ R.T, scales, colours, surface.start.occlusion)
        rendered.append(rasterise(*surfels, surround.fine(look), side="front", settings=raster))
    return rendered


def _normal_depths(renders: Sequence[Rendered], looks: Sequence[Look], guide: Guide[Any]) -> list[Tensor]:
    pairs = zip(renders, looks, strict=True)
    return [normal_depth(r.normal, r.depth, r.alpha, guide.surround.fine(look)) for r, look in pairs]


def _times(settings: PhaseSettings, draws: Tensor) -> list[float]:
    """The noise of every step, from uniform ``draws`` (steps,)."""
    at = torch.linspace(0, 1, len(draws))
    (low, high), (last_low, last_high) = settings.times
    least, most = low + (last_low - low) * at, high + (last_high - high) * at
    return (least + (most - least) * draws).tolist()
