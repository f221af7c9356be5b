"""Sessions of ONNX networks."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path

import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as state

from soar.errors import ModelFileError
from soar.models import records
from soar.models.catalogue import fetch_command

_UNREADABLE = (state.InvalidProtobuf, state.InvalidGraph, state.InvalidArgument, state.Fail, state.NotImplemented)

Shape = tuple[int | None, ...]


@dataclasses.dataclass(frozen=True)
class Signature:
    """What a network takes and gives: float32 tensors by name.

    Attributes:
        inputs, outputs: shape of each; None stands for an axis that must be free.
        integers: names of the inputs that are int64.
    """

    inputs: Mapping[str, Shape]
    outputs: Mapping[str, Shape]
    integers: frozenset[str] = frozenset()


def session(path: str | os.PathLike[str], threads: int, signature: Signature | None = None) -> ort.InferenceSession:
    """Open an ONNX file for inference on the processor.

    Args:
        path: the file; one that we installed is checked against its recorded sha256.
        threads: threads of one inference.
        signature: what the network must take and give, where the caller knows.

    Raises:
        ModelFileError: the file is missing, altered, truncated, no ONNX network, or one of another signature.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelFileError(f"{path} is missing", cure=f"run {fetch_command(path.name)}, or name a file that is there")
    records.check(path.parent, path.name)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Several jobs share the machine: threads that spin while waiting would slow each other down.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        # By its path: weights of more than 2 GB lie in a file beside it.
        opened = ort.InferenceSession(os.fspath(path), options, providers=["CPUExecutionProvider"])
    except _UNREADABLE as error:
        raise ModelFileError(
            f"{path} is not a usable ONNX network: {error}",
            cure=f"delete the file and run {fetch_command(path.name)}",
        ) from error
    if signature is not None:
        _check(path, "inputs", signature.inputs, signature.integers, opened.get_inputs())
        _check(path, "outputs", signature.outputs, frozenset(), opened.get_outputs())
    return opened


def _check(
    path: Path, what: str, expected: Mapping[str, Shape], integers: frozenset[str], offered: list[ort.NodeArg]
) -> None:
    """Compare one side of a signature with what the file offers, where a free axis has a name instead of a size."""
    found = {node.name: tuple(d if isinstance(d, int) else None for d in node.shape) for node in offered}
    types = all(node.type == ("tensor(int64)" if node.name in integers else "tensor(float)") for node in offered)
    if found != dict(expected) or not types:
        raise ModelFileError(
            f"{path} has other {what} than this stage needs",
            expected=", ".join(
                f"{name} {shape} {'int64' if name in integers else 'float32'}" for name, shape in expected.items()
            ),
            got=", ".join(f"{node.name} {tuple(node.shape)} {node.type}" for node in offered),
            cure="name a network made for this stage, or none for the bundled one",
        )
