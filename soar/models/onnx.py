"""Sessions of ONNX networks."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path

import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state as state

from soar.errors import ConfigError, ModelFileError
from soar.models import records
from soar.models.catalogue import fetch_command

_UNREADABLE = (state.InvalidProtobuf, state.InvalidGraph, state.InvalidArgument, state.Fail, state.NotImplemented)

ANY = -1
"""An axis that may have any size, or none of its own."""

Shape = tuple[int | None, ...]


@dataclasses.dataclass(frozen=True)
class Signature:
    """What a network takes and gives: float32 tensors by name.

    Attributes:
        inputs, outputs: shape of each. None stands for an axis that must be free, :data:`ANY` for one that need not be,
            a number for one of this size or free.
        integers: names of the inputs that are int64.
        others_may_follow: the network may take or give more besides.
    """

    inputs: Mapping[str, Shape]
    outputs: Mapping[str, Shape]
    integers: frozenset[str] = frozenset()
    others_may_follow: bool = False


def session(
    path: str | os.PathLike[str], threads: int, signature: Signature | None = None, device: str = "cpu"
) -> ort.InferenceSession:
    """Open an ONNX file for inference.

    Args:
        path: the file; one that we installed is checked against its recorded sha256.
        threads: threads of one inference.
        signature: what the network must take and give, where the caller knows.
        device: ``cpu``; ``cuda``, which needs the package onnxruntime-gpu; ``auto``: cuda where it is to be had.

    Raises:
        ConfigError: there is no such device here.
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
        opened = ort.InferenceSession(os.fspath(path), options, providers=_providers(device))
    except _UNREADABLE as error:
        raise ModelFileError(
            f"{path} is not a usable ONNX network: {error}",
            cure=f"delete the file and run {fetch_command(path.name)}",
        ) from error
    if signature is not None:
        _check(path, "inputs", signature.inputs, signature, opened.get_inputs())
        _check(path, "outputs", signature.outputs, signature, opened.get_outputs())
    return opened


def _providers(device: str) -> list[str]:
    cpu, cuda = "CPUExecutionProvider", "CUDAExecutionProvider"
    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError("unknown device", expected="auto, cpu, cuda", got=device)
    there = cuda in ort.get_available_providers()
    if device == "cuda" and not there:
        raise ConfigError(
            "device cuda: this onnxruntime has no CUDA",
            got=", ".join(ort.get_available_providers()),
            cure="use auto or cpu, or install onnxruntime-gpu in place of onnxruntime",
        )
    return [cuda, cpu] if there and device != "cpu" else [cpu]


def _check(
    path: Path, what: str, expected: Mapping[str, Shape], signature: Signature, offered: list[ort.NodeArg]
) -> None:
    """Compare one side of a signature with what the file offers, where a free axis has a name instead of a size."""
    integers = signature.integers if what == "inputs" else frozenset()
    found = {node.name: tuple(d if isinstance(d, int) else None for d in node.shape) for node in offered}
    wanted = [node for node in offered if node.name in expected]
    types = all(node.type == ("tensor(int64)" if node.name in integers else "tensor(float)") for node in wanted)
    names = expected.keys() <= found.keys() if signature.others_may_follow else expected.keys() == found.keys()
    if not (names and types and all(_fits(shape, found[name]) for name, shape in expected.items())):
        raise ModelFileError(
            f"{path} has other {what} than this stage needs",
            expected=", ".join(
                f"{name} {_text(shape)} {'int64' if name in integers else 'float32'}"
                for name, shape in expected.items()
            ),
            got=", ".join(f"{node.name} {tuple(node.shape)} {node.type}" for node in offered),
            cure="name a network made for this stage; `python -m soar models check PATH` tells what a file is",
        )


def _fits(expected: Shape, found: Shape) -> bool:
    return len(expected) == len(found) and all(
        need in (ANY, have) or have is None for need, have in zip(expected, found, strict=True)
    )


def _text(shape: Shape) -> str:
    return "(" + ", ".join({ANY: "any", None: "free"}.get(axis, str(axis)) for axis in shape) + ")"
