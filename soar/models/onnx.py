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
from soar.models.onnx_file import Port, Ports, inspect

_UNREADABLE = (
    state.InvalidProtobuf, state.InvalidGraph, state.InvalidArgument, state.Fail, state.NotImplemented, state.NoModel,
    state.NoSuchFile, state.RuntimeException,
)  # fmt: skip

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
        any_names: names are the file's own; tensors are compared in order.
    """

    inputs: Mapping[str, Shape]
    outputs: Mapping[str, Shape]
    integers: frozenset[str] = frozenset()
    others_may_follow: bool = False
    any_names: bool = False


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
        ModelFileError: the file is missing, altered, unsafe (:func:`soar.models.onnx_file.inspect`), no ONNX network,
            or one of another signature.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelFileError(f"{path} is missing", cure=f"run {fetch_command(path.name)}, or name a file that is there")
    records.check(path.parent, path.name)
    inspect(path)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Several jobs share the machine: threads that spin while waiting would slow each other down.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # What was inspected is what is opened: onnxruntime would read its own format too.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    try:
        # By the path that was inspected: weights of more than 2 GB lie in a file beside it.
        opened = ort.InferenceSession(os.fspath(path.resolve()), options, providers=_providers(device))
    except _UNREADABLE as error:
        raise ModelFileError(
            f"{path} is not a usable ONNX network: {error}",
            cure=f"delete the file and run {fetch_command(path.name)}",
        ) from error
    if signature is not None:
        sides = (opened.get_inputs(), opened.get_outputs())
        compare(path, signature, Ports(*(tuple(Port(n.name, n.type, tuple(n.shape)) for n in side) for side in sides)))
    return opened


def compare(path: Path, signature: Signature, ports: Ports) -> None:
    """Compare what a network takes and gives with what it must.

    Raises:
        ModelFileError: it is another signature; says which is expected and which the file has.
    """
    _check(path, "inputs", signature.inputs, signature, ports.inputs)
    _check(path, "outputs", signature.outputs, signature, ports.outputs)


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
    path: Path, what: str, expected: Mapping[str, Shape], signature: Signature, offered: tuple[Port, ...]
) -> None:
    """Compare one side of a signature."""
    integers = signature.integers if what == "inputs" else frozenset()
    found = dict(zip(expected, offered, strict=False)) if signature.any_names else {port.name: port for port in offered}
    complete = len(offered) >= len(expected) if signature.others_may_follow else len(offered) == len(expected)
    if not complete or not all(
        name in found
        and found[name].type == ("tensor(int64)" if name in integers else "tensor(float)")
        and _fits(shape, found[name].shape)
        for name, shape in expected.items()
    ):
        raise ModelFileError(
            f"{path} has other {what} than this stage needs",
            expected=", ".join(
                f"{'*' if signature.any_names else name} {_text(shape)} {'int64' if name in integers else 'float32'}"
                for name, shape in expected.items()
            ),
            got=", ".join(map(str, offered)),
            cure="name a network made for this stage; `python -m soar models check PATH` tells what a file is",
        )


def _fits(expected: Shape, found: tuple[int | str | None, ...] | None) -> bool:
    """Whether axes are as expected; a file that does not state a shape may have any."""
    return found is None or (
        len(expected) == len(found)
        and all(need in (ANY, have) or not isinstance(have, int) for need, have in zip(expected, found, strict=True))
    )


def _text(shape: Shape) -> str:
    return "(" + ", ".join({ANY: "any", None: "free"}.get(axis, str(axis)) for axis in shape) + ")"
