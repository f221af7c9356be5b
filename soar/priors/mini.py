"""The prior that comes with the package: :class:`soar.networks.prior.PriorNetwork`, run by onnxruntime."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Generator, Tensor

from soar.errors import NumericalError
from soar.models.onnx import session
from soar.networks import DATA
from soar.networks.diffusion import noised
from soar.networks.prior_inputs import CONDITIONED, assemble, signature
from soar.priors.protocol import VIEWS, Condition, Views

BUNDLED = DATA / "prior.onnx"
"""The network that comes with the package; ``docs/networks.md`` is its model card."""


class MiniPrior:
    """Estimates four clean views of a person from four noisy ones and one picture.

    Args:
        network: an ONNX file, or None for the bundled one.
        size: side of its pictures, pixels.
        threads: of one inference.

    Raises:
        ModelFileError: the network is missing, altered, or of another signature.
    """

    def __init__(self, network: str | Path | None, size: int, threads: int) -> None:
        self.size = size
        self.session = session(network or BUNDLED, threads, signature(size))

    def __call__(
        self, noisy: np.ndarray, time: float, given: Mapping[str, np.ndarray], guidance: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """One step from noise to the estimate of the clean views.

        Args:
            noisy: (4, 3, S, S) float32, :func:`soar.networks.diffusion.noised` pictures in [-1, 1].
            time: in (0, 1]; at 1 ``noisy`` says nothing and is taken to be its mean, zero: the answer is the network's
                direct guess, a tenth of a decibel nearer than from any one draw.
            given: the other inputs of :func:`soar.networks.prior_inputs.signature` without batch axis, conditioned.
            guidance: 0 ignores the picture, 1 follows it, more exaggerates what it says: classifier-free guidance (Ho
                and Salimans, 2022). At 0 and 1 the network runs for one sample, else for two.

        Returns:
            clean (4, 3, S, S), and its coverage (4, 1, S, S) in [0, 1], which is not exaggerated: that of the estimate
            that follows the picture, except at 0.
        """
        conditioned = (guidance,) if guidance in (0, 1) else (1, 0)
        count = len(conditioned)
        feed = {name: np.stack([value] * count) for name, value in given.items()}
        feed["flags"][:, CONDITIONED] = conditioned
        feed["noisy"] = np.stack([np.asarray(noisy, np.float32) * np.float32(time < 1)] * count)
        feed["time"] = np.full(count, time, np.float32)
        clean, coverage = self.session.run(["clean", "coverage"], feed)
        if count == 1:
            return clean[0], coverage[0]
        with_picture, without = clean
        return without + np.float32(guidance) * (with_picture - without), coverage[0]


@dataclasses.dataclass(frozen=True)
class MiniSettings:
    """Node ``prior`` with the provider ``mini``.

    Attributes:
        provider: ``mini``.
        network: an ONNX file of the same signature, or None for the bundled one.
        size: side of its pictures, pixels.
        guidance: see :meth:`MiniPrior.__call__`.
    """

    provider: Literal["mini"]
    network: str | None
    size: int
    guidance: float


class MiniProvider:
    """The provider ``mini``; see :class:`soar.priors.protocol.MultiViewPrior`. Text says nothing to it.

    Pictures are distilled in [-1, 1] before grey, weighted by the renders' alpha: what the estimate says of the
    background must not pull at the rim. Of colours the prior is told the renders' alpha, since their shape is final by
    then; of normals, whose shape is in the making, the body's.
    """

    def __init__(self, prior: MiniPrior, guidance: float) -> None:
        self.prior, self.guidance, self.size = prior, guidance, prior.size

    @classmethod
    def bundled(cls, options: MiniSettings, models: Path, threads: int) -> MiniProvider:
        """The provider of a configuration; ``models`` is ignored, the network comes with the package.

        Raises:
            ModelFileError: as :class:`MiniPrior`.
        """
        return cls(MiniPrior(options.network, options.size, threads), options.guidance)

    def prepare(self, conditions: Sequence[Condition]) -> list[Condition]:
        """See the protocol: there is nothing to encode."""
        return list(conditions)

    def estimate(self, prompt: Condition, views: Views, time: float, generator: Generator) -> Tensor:
        """See the protocol."""
        return (self._clean(prompt, views, time, generator) + 1) / 2

    def loss(self, prompt: Condition, views: Views, time: float, generator: Generator) -> Tensor:
        """See the protocol."""
        difference = _before_grey(views.pictures, views.alpha) - self._clean(prompt, views, time, generator)
        return 0.5 * (views.alpha.detach() * difference.square()).sum() / VIEWS

    def _clean(self, prompt: Condition, views: Views, time: float, generator: Generator) -> Tensor:
        """(4, 3, S, S) estimate in [-1, 1] before grey, on the device of the views."""
        pictures = _before_grey(views.pictures, views.alpha).detach().cpu().float()
        given = assemble(
            _before_grey(prompt.picture, prompt.alpha).detach().cpu().float().numpy(),
            torch.cat([views.geometry, prompt.geometry[None]]).detach().cpu().float().numpy(),
            torch.cat([views.alpha, prompt.alpha[None]]).detach().cpu().float().numpy(),
            normals=prompt.domain == "normal",
            alpha_known=prompt.domain == "colour",
        )
        noise = torch.randn(pictures.shape, generator=generator, device=generator.device).cpu()
        noisy = noised(pictures[None], noise[None], torch.tensor([time]))[0]
        clean, _ = self.prior(noisy.numpy(), time, given, self.guidance)
        if not np.isfinite(clean).all():
            raise NumericalError("the prior mini gave NaN or infinity", cure="report this; its inputs were finite")
        return torch.from_numpy(clean).clamp(-1, 1).to(views.pictures)


def _before_grey(pictures: Tensor, alpha: Tensor) -> Tensor:
    """Pictures in [0, 1], multiplied by alpha, as the network has them: in [-1, 1], where grey is 0."""
    return 2 * pictures - alpha
