"""Reconstruction (paper, section 3.2): move surfels until every frame of the training cameras is explained."""

from __future__ import annotations

import dataclasses
from typing import Literal

import torch
from torch import Tensor

from soar.avatar.articulate import Articulation, pose
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar, nearest
from soar.errors import NumericalError
from soar.losses.lpips import Lpips
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.objective import Targets, Weights, image_terms, surface_terms
from soar.optimise.parameters import Rates, Surface, cosine_decay
from soar.optimise.sobolev import Sobolev
from soar.optimise.views import Views, epochs
from soar.progress import track
from soar.raster import RasterSettings, rasterise_both


@dataclasses.dataclass(frozen=True)
class ReconstructSettings:
    """The loop (``conf/reconstruct``)."""

    steps: int
    start: Literal["paint", "grey"]
    lpips: Literal["alex", "vgg"]
    rates: Rates
    final_rate: float
    weights: Weights
    laplacian_neighbours: int
    smoothing: int
    symmetry: float
    mask_ramp: tuple[float, float]
    reskin_every: int
    window_margin: int
    cache_mb: int
    checkpoint_seconds: float


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
    views = [view.hardened(*settings.mask_ramp).tightened(settings.window_margin) for view in views]
    generator = torch.Generator().manual_seed(seed)
    surface = Surface(start, avatar, generator).to(start.positions.device)
    order = epochs(views, settings.steps, generator)
    backgrounds = torch.rand(settings.steps, 3, generator=generator).to(start.positions)
    optimisers = surface.optimisers(settings.rates, shared=settings.smoothing > 0)
    _, ring = nearest(start.rest_positions, start.rest_positions, settings.laplacian_neighbours + 1)
    spread = Sobolev.of(start.rest_positions, ring, settings.smoothing, left.to(start.positions), settings.symmetry)
    targets = Targets(views, lpips, settings.cache_mb)
    curves: dict[str, list[float]] = {}
    first = 0
    if (state := checkpoint.load()) is not None:
        surface.load_state_dict(state["surface"])
        for optimiser, stored in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(stored)
        first, curves = state["step"], state["curves"]

    def save(step: int) -> None:
        checkpoint.save(
            {
                "step": step,
                "surface": surface.state_dict(),
                "optimisers": [o.state_dict() for o in optimisers],
                "curves": curves,
            }
        )

    def require_finite(what: str, values: dict[str, Tensor]) -> None:
        if not bool(torch.isfinite(torch.stack(list(values.values()))).all()):
            save(step)
            raise _not_finite(what, values, step, checkpoint)

    def look(view: int, index: int, background: Tensor) -> dict[str, Tensor]:
        """The terms of one crop."""
        colours, scales = surface.attributes()
        transforms = articulation.in_camera(int(views[view].frames[index]), views[view].T_cam_from_world)
        positions, normals = pose(surface.positions, surface.normals, blend, transforms)
        pinhole = views[view].pinhole(index)
        front, back = rasterise_both(positions, normals, scales, colours, start.occlusion, pinhole, settings=raster)
        terms = image_terms(front, back, targets, view, index, background, settings.weights)
        return terms | surface_terms(surface.positions, scales, start, ring[:, 1:], settings.weights)

    for step in track(range(first, settings.steps), "reconstruct"):
        if step % settings.reskin_every == 0 or step == first:
            # Only where the skinning weights are renewed are they a function of the state that is saved.
            if step > first and checkpoint.due():
                save(step)
            blend = articulation.blend(surface.positions, start.neighbours)
        terms = look(*order[step], backgrounds[step])
        weighted = {name: getattr(settings.weights, name) * value for name, value in terms.items()}
        require_finite("loss term", weighted)
        decay = cosine_decay(step, settings.steps, settings.final_rate)
        for group in (g for optimiser in optimisers for g in optimiser.param_groups):
            group["lr"] = group["initial"] * decay
        surface.zero_grad(set_to_none=True)
        torch.stack(list(weighted.values())).sum().backward()
        gradients = {name: p.grad.sum() for name, p in surface.named_parameters() if p.grad is not None}
        require_finite("gradient of", gradients)
        surface.positions.grad = spread(surface.positions.grad)
        for optimiser in optimisers:
            optimiser.step()
        for name, value in terms.items():
            curves.setdefault(name, []).append(float(value.detach()))
    return surface.avatar(), curves


def _not_finite(what: str, values: dict[str, Tensor], step: int, checkpoint: Checkpoint) -> NumericalError:
    culprits = [name for name, value in values.items() if not bool(torch.isfinite(value))]
    return NumericalError(
        f"reconstruction stopped at step {step}: {what} {', '.join(culprits)} is not finite",
        expected="finite numbers",
        got=", ".join(f"{name} = {float(value.detach())}" for name, value in values.items()),
        cure=f"lower the rates in conf/reconstruct or look at the inputs; the last good state is in {checkpoint.path}",
    )
