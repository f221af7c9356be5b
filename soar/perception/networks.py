"""One network with one image input: crops in, named outputs out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soar.errors import ModelFileError
from soar.models import onnx
from soar.models.catalogue import fetch_command


class Network:
    """An ONNX network whose only input is a (1, H, H, 3) float32 RGB image.

    Args:
        path: the ``.onnx`` file.
        outputs: names and shapes the file must offer, batch dimension included.
        span: (low, high) range into which [0, 255] is mapped.
        threads: threads one inference may use.

    Raises:
        ModelFileError: the file is missing or corrupt, or has other inputs or outputs than expected.
    """

    def __init__(
        self, path: Path, outputs: dict[str, tuple[int, ...]], span: tuple[float, float], threads: int
    ) -> None:
        self._session = onnx.session(path, threads)
        self._outputs = list(outputs)
        self._low, self._scale = span[0], (span[1] - span[0]) / 255
        inputs = self._session.get_inputs()
        offered = {o.name: tuple(o.shape) for o in self._session.get_outputs()}
        if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[3] != 3:
            raise ModelFileError(f"{path} is not an image network", expected="one input (1, H, H, 3)", got=str(inputs))
        missing = {k: v for k, v in outputs.items() if offered.get(k) != v}
        if missing:
            raise ModelFileError(
                f"{path} has other outputs than expected",
                expected=str(missing),
                got=str(offered),
                cure=f"delete the file and run {fetch_command(path.name)}; check the configured model name",
            )
        self._input, self.size = inputs[0].name, int(inputs[0].shape[1])

    def __call__(self, crop: np.ndarray) -> list[np.ndarray]:
        """Run on a (size, size, 3) uint8 crop; returns the outputs in the order given, without batch dimension."""
        tensor = crop[None].astype(np.float32) * np.float32(self._scale) + np.float32(self._low)
        return [out[0] for out in self._session.run(self._outputs, {self._input: tensor})]
