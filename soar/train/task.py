"""What a training is about, as the loop sees it: network, stream of samples, loss, picture, file at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from torch import Tensor, nn

Split = Literal["train", "validate"]


class Task(Protocol):
    """One kind of training; the loop knows nothing else about it. It must be picklable: workers receive a copy."""

    def network(self) -> nn.Module:
        """A network with fresh weights, drawn from torch's global generator."""
        ...

    def batch(self, split: Split, index: int) -> dict[str, np.ndarray]:
        """Batch ``index`` of a stream: a function of the arguments alone, arrays with a leading batch axis."""
        ...

    def loss(self, network: nn.Module, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The value to minimise, and figures to record with it, all scalars."""
        ...

    def sheet(self, network: nn.Module, batch: dict[str, Tensor]) -> np.ndarray:
        """(H, W, 3) uint8: what the network makes of some samples, beside the truth."""
        ...

    def evaluate(self, path: Path | None, folder: Path, threads: int) -> None:
        """Measure the network in the file ``path``, or the bundled one, beside its baseline; print, and write to
        ``folder``."""
        ...

    def export(self, network: nn.Module, path: Path, facts: Mapping[str, Any]) -> None:
        """Write the finished network as ONNX to ``path`` and ``facts`` about its training to its record."""
        ...
