"""The prior that comes with the package: :class:`soar.networks.prior.PriorNetwork`, run by onnxruntime."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from soar.models.onnx import session
from soar.networks import DATA
from soar.networks.prior_inputs import CONDITIONED, signature

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
            time: in (0, 1]; at 1 ``noisy`` is pure noise, and the answer is the network's direct guess.
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
        feed["noisy"] = np.stack([np.asarray(noisy, np.float32)] * count)
        feed["time"] = np.full(count, time, np.float32)
        clean, coverage = self.session.run(["clean", "coverage"], feed)
        if count == 1:
            return clean[0], coverage[0]
        with_picture, without = clean
        return without + np.float32(guidance) * (with_picture - without), coverage[0]
