"""What the refinement asks of a multi-view prior: one protocol for every provider.

Pictures are (3, S, S) in [0, 1] and *multiplied by alpha*: what a renderer sums up, before any background. Normal maps
are pictures too: a normal n of this project (camera space, n_z < 0 in front) is the colour ``(n + 1) / 2``, times
alpha. Whatever background, range or axes a network was trained with, its provider sees to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, Protocol, TypeVar

from torch import Generator, Tensor

from soar.networks.prior_inputs import VIEWS

__all__ = ["VIEWS", "Condition", "Domain", "MultiViewPrior", "Views"]

Domain = Literal["colour", "normal"]

Prompt = TypeVar("Prompt")


@dataclasses.dataclass(frozen=True)
class Condition:
    """What is known of a person: one picture of them, and words.

    Attributes:
        domain: what the pictures of condition and views show.
        picture: (3, S, S) the image prompt.
        alpha: (1, S, S) of it.
        geometry: (7, S, S) of the posed body in it, :mod:`soar.networks.prior_inputs`.
        text: the text prompt.
    """

    domain: Domain
    picture: Tensor
    alpha: Tensor
    geometry: Tensor
    text: str


@dataclasses.dataclass(frozen=True)
class Views:
    """Renders of the avatar from four sides. Only pictures and alpha have gradients.

    Attributes:
        pictures: (4, 3, S, S).
        alpha: (4, 1, S, S).
        geometry: (4, 7, S, S) of the posed body.
        azimuth: (4,) degrees from the body's front towards its left.
        elevation: (4,) degrees above the horizon.
    """

    pictures: Tensor
    alpha: Tensor
    geometry: Tensor
    azimuth: Tensor
    elevation: Tensor


class MultiViewPrior(Protocol[Prompt]):
    """A diffusion model of four views of one person, given one picture of them.

    Attributes:
        size: S, side of its pictures, pixels.
    """

    size: int

    def prepare(self, conditions: Sequence[Condition]) -> list[Prompt]:
        """Encode everything that will ever be conditioned on, once; encoders need not stay in memory afterwards.

        Raises:
            ModelFileError: weights are missing, unsafe, or not the right ones.
        """
        ...

    def estimate(self, prompt: Prompt, views: Views, time: float, generator: Generator) -> Tensor:
        """(4, 3, S, S) in [0, 1], detached: what the views should look like, before the provider's own background.

        Args:
            prompt: of :meth:`prepare`.
            views: the renders.
            time: noise that is added first, as a share of the schedule, in (0, 1].
            generator: draws it.

        Raises:
            NumericalError: the network gave NaN or infinity.
        """
        ...

    def loss(self, prompt: Prompt, views: Views, time: float, generator: Generator) -> Tensor:
        """Half the squared distance of the renders to :meth:`estimate`, summed, over the number of views: a scalar.

        In the space that the provider distils in: of pictures in [-1, 1], or of latents. Arguments and errors as
        :meth:`estimate`. The gradient with respect to that space's renders is ``(render - estimate) / 4``: that of
        score distillation, ``eps_hat - eps``, times ``sigma / alpha / 4`` (docs/priors.md).
        """
        ...
