"""Noise of Stable Diffusion 2.1: ``z_t = alpha z + sigma eps`` at 1000 steps of the "scaled linear" schedule."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

STEPS = 1000
_FIRST, _LAST = 0.00085, 0.0120  # variances that the first and last step add


@functools.cache
def alphas_cumprod() -> Tensor:
    """(1000,) float64: the square of ``alpha`` at every step."""
    betas = torch.linspace(_FIRST**0.5, _LAST**0.5, STEPS, dtype=torch.float64) ** 2
    return (1 - betas).cumprod(0)


def step_at(time: float) -> int:
    """The step that lies a share ``time`` in [0, 1] along the schedule."""
    return min(int(STEPS * time), STEPS - 1)


def levels(step: int) -> tuple[float, float]:
    """``alpha`` and ``sigma`` of a step."""
    square = float(alphas_cumprod()[step])
    return square**0.5, (1 - square) ** 0.5


def clean(noisy: Tensor, noise: Tensor, step: int) -> Tensor:
    """The estimate of ``z`` from ``z_t`` and an estimate of the noise, of any shape."""
    alpha, sigma = levels(step)
    return (noisy - sigma * noise) / alpha


def rescaled(guided: Tensor, conditional: Tensor, share: float) -> Tensor:
    """Guided estimates (4, C, h, w), brought part of the way to the contrast of the conditional ones.

    Guidance exaggerates contrast (Lin et al., 2023). The factor is the ratio of the standard deviations of all values
    of the group; ``share`` in [0, 1] of it is applied.
    """
    tiny = 1e-8  # as in the released guidance
    factor = (conditional.std() + tiny) / (guided.std() + tiny)
    return share * factor * guided + (1 - share) * guided
