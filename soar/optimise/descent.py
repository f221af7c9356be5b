"""Step after step down a sum of weighted terms, resumable: the loop that reconstruction and refinement share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from soar.avatar.articulate import Articulation
from soar.avatar.surfels import nearest
from soar.errors import NumericalError
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.parameters import Rates, Surface, cosine_decay
from soar.optimise.sobolev import Sobolev
from soar.progress import track

Terms = dict[str, tuple[float, Tensor]]
"""Weight and unweighted value of every term of one step."""


@dataclasses.dataclass(frozen=True)
class DescentSettings:
    """How steps are taken (``conf/reconstruct``, ``conf/refine``).

    Attributes:
        steps: number of them.
        rates: Adam step sizes at the first; what has rate 0 stays as it is.
        final_rate: share of them at the last, along half a cosine.
        laplacian_neighbours: neighbours of a surfel at rest.
        smoothing: times the positions' gradient is averaged over those.
        symmetry: weight of the mirror image's gradient beside one's own.
        reskin_every: steps between renewals of the skinning weights.
        checkpoint_seconds: least time between two saves.
    """

    steps: int
    rates: Rates
    final_rate: float
    laplacian_neighbours: int
    smoothing: int
    symmetry: float
    reskin_every: int
    checkpoint_seconds: float


def descend(
    name: str,
    surface: Surface,
    articulation: Articulation,
    left: Tensor,
    settings: DescentSettings,
    checkpoint: Checkpoint,
    look: Callable[[int, Tensor, Tensor], Terms],
) -> dict[str, list[float]]:
    """Optimise ``surface`` in place.

    ``look(step, blend, ring)`` computes the terms of a step from the surface, the skinning weights (N, B) and the
    neighbours (N, k) of every surfel at rest. It must be a function of its arguments and the surface alone: then a run
    that was killed and goes on from its checkpoint ends with the same bits as one that was not.

    Returns:
        the unweighted value of every term at every step that had it.

    Raises:
        NumericalError: a term or a gradient is not finite; the state before that step is in the checkpoint.
    """
    start = surface.start
    optimisers = surface.optimisers(settings.rates, shared=settings.smoothing > 0)
    _, ring = nearest(start.rest_positions, start.rest_positions, settings.laplacian_neighbours + 1)
    spread = Sobolev.of(start.rest_positions, ring, settings.smoothing, left.to(start.positions), settings.symmetry)
    curves: dict[str, list[float]] = {}
    first, skinned = 0, start.positions  # where the surfels were when their skinning weights were renewed
    if (state := checkpoint.load()) is not None:
        surface.load_state_dict(state["surface"])
        for optimiser, stored in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(stored)
        first, curves, skinned = state["step"], state["curves"], state["skinned"]
    blend = articulation.blend(skinned, start.neighbours)

    def save(step: int) -> None:
        state = {"step": step, "surface": surface.state_dict(), "skinned": skinned, "curves": curves}
        checkpoint.save(state | {"optimisers": [optimiser.state_dict() for optimiser in optimisers]})

    def require_finite(what: str, values: Mapping[str, Tensor]) -> None:
        if not bool(torch.isfinite(torch.stack(list(values.values()))).all()):
            save(step)
            raise _not_finite(name, what, values, step, checkpoint)

    for step in track(range(first, settings.steps), name):
        if step > first and checkpoint.due():
            save(step)
        if step % settings.reskin_every == 0:
            skinned = surface.positions.detach().clone()
            blend = articulation.blend(skinned, start.neighbours)
        try:
            terms = look(step, blend, ring)
        except NumericalError:
            save(step)
            raise
        weighted = {term: weight * value for term, (weight, value) in terms.items()}
        require_finite("loss term", weighted)
        decay = cosine_decay(step, settings.steps, settings.final_rate)
        for group in (g for optimiser in optimisers for g in optimiser.param_groups):
            group["lr"] = group["initial"] * decay
        surface.zero_grad(set_to_none=True)
        torch.stack(list(weighted.values())).sum().backward()
        gradients = {part: p.grad.sum() for part, p in surface.named_parameters() if p.grad is not None}
        require_finite("gradient of", gradients)
        if surface.positions.grad is not None:
            surface.positions.grad = spread(surface.positions.grad)
        for optimiser in optimisers:
            optimiser.step()
        for term, (_, value) in terms.items():
            curves.setdefault(term, []).append(float(value.detach()))
    if first < settings.steps:
        save(settings.steps)  # what follows may be killed too
    return curves


def _not_finite(
    name: str, what: str, values: Mapping[str, Tensor], step: int, checkpoint: Checkpoint
) -> NumericalError:
    culprits = [part for part, value in values.items() if not bool(torch.isfinite(value))]
    return NumericalError(
        f"{name} stopped at step {step}: {what} {', '.join(culprits)} is not finite",
        expected="finite numbers",
        got=", ".join(f"{part} = {float(value.detach())}" for part, value in values.items()),
        cure=f"lower the rates in its configuration or look at the inputs; the last good state is in {checkpoint.path}",
    )
