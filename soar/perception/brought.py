"""Networks that others made: opened, asked what they take and give, fed what they ask for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as state

from soar.errors import ConfigError, ModelFileError
from soar.models.onnx import session

_TYPES: dict[str, type] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}

Axes = tuple[int | None, ...]


def brought_file(brought: Mapping[str, Path], key: str, where: str) -> Path:
    """The file or folder that the configuration names as ``where.key``.

    Raises:
        ConfigError: it names none.
    """
    if key not in brought:
        raise ConfigError(f"{where}.{key} is not set", expected="a path", cure=f"add the override {where}.{key}=PATH")
    return brought[key]


class BroughtNetwork:
    """One ONNX file whose inputs and outputs are not known before it is opened.

    Args:
        path: the file.
        threads: threads of one inference.
        device: auto, cpu or cuda.

    Attributes:
        inputs, outputs: name -> sizes of the axes, None for a free one; () where the file does not tell.

    Raises:
        ConfigError: there is no such device.
        ModelFileError: the file is missing or no ONNX network, or takes another type of numbers.
    """

    def __init__(self, path: Path, threads: int, device: str) -> None:
        self.path = path
        self._session = session(path, threads, device=device)
        nodes = self._session.get_inputs()
        self.inputs = {node.name: _axes(node) for node in nodes}
        self.outputs = {node.name: _axes(node) for node in self._session.get_outputs()}
        if any(node.type not in _TYPES for node in nodes):
            raise self.misfit(f"inputs of the types {', '.join(_TYPES)}")
        self._types = {node.name: _TYPES[node.type] for node in nodes}

    def __call__(self, feed: Mapping[str, np.ndarray], wanted: Iterable[str]) -> dict[str, np.ndarray]:
        """The outputs ``wanted`` as float32, by name; every input is cast to the type the file asks for.

        Raises:
            ModelFileError: the network does not run on these shapes, or answers with NaN or infinity.
        """
        cast = {name: np.ascontiguousarray(value, self._types[name]) for name, value in feed.items()}
        names = list(wanted)
        try:
            found = self._session.run(names, cast)
        except (state.Fail, state.InvalidArgument, state.RuntimeException) as error:
            shapes = ", ".join(f"{name} {value.shape}" for name, value in cast.items())
            raise self.misfit(f"a network that runs on {shapes}", str(error)) from error
        result = {name: np.asarray(value, np.float32) for name, value in zip(names, found, strict=True)}
        if bad := [name for name, value in result.items() if not np.isfinite(value).all()]:
            raise self.misfit("finite numbers", f"NaN or infinity in {', '.join(bad)}")
        return result

    def misfit(self, expected: str, reason: str = "") -> ModelFileError:
        """The error that the file is not what is needed; it tells what was expected and what the file offers."""
        return ModelFileError(
            f"{self.path} is not the network that the configuration describes" + (f": {reason}" if reason else ""),
            expected=expected,
            got=self.signature,
            cure="name the right file, or describe this one in conf/",
        )

    @property
    def signature(self) -> str:
        """Inputs and outputs in words."""
        takes, gives = (
            ", ".join(f"{node.name} {node.shape} {node.type.removeprefix('tensor')}" for node in nodes)
            for nodes in (self._session.get_inputs(), self._session.get_outputs())
        )
        return f"takes {takes}; gives {gives}"


def fits(expected: Axes, found: Axes) -> bool:
    """Whether the axes of a file may have the ``expected`` sizes; None stands for any on either side, () for untold."""
    return not found or (
        len(expected) == len(found)
        and all(None in (need, have) or need == have for need, have in zip(expected, found, strict=True))
    )


def _axes(node: ort.NodeArg) -> Axes:
    return tuple(axis if isinstance(axis, int) else None for axis in node.shape)
