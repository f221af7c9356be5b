"""A gentler direction for the positions: what pushes one surfel moves its neighbours and its mirror image too.

Each surfel moving by its own noisy pixels frays the silhouette; and an outline seen from one side says nothing of the
other, but bodies, and mostly clothes, are the same on both. Only the gradient is changed, never the objective: where
the two sides do look different, each is pulled its own way.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from soar.avatar.surfels import nearest


@dataclasses.dataclass(frozen=True)
class Sobolev:
    """A linear map of position gradients (N, 3).

    Attributes:
        ring: (N, k) each surfel and its nearest neighbours at rest.
        times: how often the gradient is replaced by its mean over the ring (a Sobolev gradient; Nicolet et al. 2021
            solve for the same effect).
        twin: (N,) the surfel nearest to the mirror image of each.
        left: (3,) unit normal of the mirror, which contains the origin.
        symmetry: weight of the mirrored gradient beside one's own, 0 to 1.
    """

    ring: Tensor
    times: int
    twin: Tensor
    left: Tensor
    symmetry: float

    @staticmethod
    def of(rest: Tensor, ring: Tensor, times: int, left: Tensor, symmetry: float) -> Sobolev:
        """For surfels at rest positions (N, 3) in the canonical pose."""
        twin = nearest(rest, reflected(rest, left), 1)[1][:, 0] if symmetry else torch.arange(len(rest))
        return Sobolev(ring, times, twin, left, symmetry)

    def __call__(self, gradient: Tensor) -> Tensor:
        """The gradient (N, 3) spread over neighbours and twins; its sum over all surfels of one side stays in scale."""
        for _ in range(self.times):
            gradient = gradient.index_select(0, self.ring.flatten()).unflatten(0, self.ring.shape).mean(1)
        if self.symmetry:
            mirrored = reflected(gradient[self.twin], self.left)
            gradient = (gradient + self.symmetry * mirrored) / (1 + self.symmetry)
        return gradient


def reflected(vectors: Tensor, normal: Tensor) -> Tensor:
    """Vectors (N, 3) in a mirror through the origin with unit ``normal`` (3,)."""
    return vectors - 2 * (vectors @ normal)[:, None] * normal
