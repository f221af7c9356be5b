"""The noise of the multi-view prior: the variance-preserving cosine schedule (Nichol and Dhariwal, 2021), continuous.

A noised picture is ``x_t = alpha x_0 + sigma eps`` with ``alpha = cos(pi t / 2)``, ``sigma = sin(pi t / 2)``, t in
[0, 1]; at t = 1 it is pure noise and says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from torch import Tensor


def levels(t: Tensor) -> tuple[Tensor, Tensor]:
    """``alpha`` and ``sigma`` of times (N,), shaped (N, 1, 1, 1, 1) to multiply views (N, V, 3, H, W)."""
    angle = (0.5 * math.pi * t)[:, None, None, None, None]
    return angle.cos(), angle.sin()


def noised(x0: Tensor, noise: Tensor, t: Tensor) -> Tensor:
    """(N, V, 3, H, W) pictures at times t (N,)."""
    alpha, sigma = levels(t)
    return alpha * x0 + sigma * noise


def sample(denoise: Callable[[Tensor, Tensor], Tensor], noise: Tensor, steps: int) -> Tensor:
    """Pictures by ``steps`` deterministic steps from pure noise to none (DDIM, Song et al., 2021).

    Args:
        denoise: maps ``x_t`` (N, V, 3, H, W) and t (N,) to an estimate of ``x_0``.
        noise: (N, V, 3, H, W) standard normal.
        steps: evaluations of ``denoise``.
    """
    x = noise
    for step in range(steps, 0, -1):
        now, after = (noise.new_full((len(noise),), k / steps) for k in (step, step - 1))
        x0 = denoise(x, now)
        alpha, sigma = levels(now)
        x = noised(x0, (x - alpha * x0) / sigma, after)
    return x
