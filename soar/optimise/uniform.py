"""Adam whose step size is shared by all elements of a tensor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch


class UniformAdam(torch.optim.Optimizer):
    """Adam with one second moment per tensor, that of the largest row (Nicolet et al. 2021, "Large steps").

    Plain Adam moves every element by about its rate, however small its gradient: a surfel that a hundred pixels push
    and one that hears a faint echo through its neighbours go equally far. Here the largest row moves by the rate and
    the others in proportion, so a smooth gradient makes a smooth step.

    Args:
        params: tensors (N, D) or groups, as for any optimiser.
        lr: step of the largest row.
        betas: decay of the two moments.
    """

    def __init__(self, params: Any, lr: float, betas: tuple[float, float] = (0.9, 0.999)) -> None:
        super().__init__(params, {"lr": lr, "betas": betas})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """One step along the bias-corrected first moment; ``closure`` is not supported."""
        for group in self.param_groups:
            first, second = group["betas"]
            for parameter in group["params"]:
                gradient = parameter.grad
                if gradient is None:
                    continue
                state = self.state[parameter]
                if not state:
                    state["step"] = torch.zeros(())
                    state["mean"] = torch.zeros_like(parameter)
                    state["square"] = parameter.new_zeros(())
                state["step"] += 1
                state["mean"].lerp_(gradient, 1 - first)
                state["square"].lerp_(gradient.square().sum(-1).max(), 1 - second)
                mean = state["mean"] / (1 - first ** state["step"])
                square = state["square"] / (1 - second ** state["step"])
                parameter.sub_(group["lr"] * mean / (square.sqrt() + 1e-30))
