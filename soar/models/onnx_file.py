"""ONNX files as they lie on disk: read without running them, and refused where they are not what they say.

onnxruntime follows every path and allocates every size that a file names. What comes from elsewhere is therefore parsed
here first: data in other files only below the file's own folder, tensors no larger than their data, known operators.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

import onnx
from google.protobuf.message import DecodeError
from onnx import TensorProto

from soar.errors import ModelFileError

LIMIT = 2**31 - 1
"""Bytes a protocol buffer can have."""

DOMAINS = frozenset({"", "ai.onnx", "ai.onnx.ml", "com.microsoft"})
"""Operators that onnxruntime brings; those of other domains are somebody's own code."""

_PACKED = {"INT2": 2, "UINT2": 2, "INT4": 4, "UINT4": 4, "FLOAT4E2M1": 4, "FLOAT6E2M3": 6, "FLOAT6E3M2": 6}
"""Bits of the types that share bytes."""

_CURE = "delete the file; run `python -m soar models fetch` if it is one of ours, else export or fetch it again"


@dataclasses.dataclass(frozen=True)
class Port:
    """An input or output of a network.

    Attributes:
        name: of the tensor.
        type: as onnxruntime writes it, such as ``tensor(float)``.
        shape: a number, or a name or None for a free axis; None where the file does not say.
    """

    name: str
    type: str
    shape: tuple[int | str | None, ...] | None

    def __str__(self) -> str:
        shape = "?" if self.shape is None else ", ".join("free" if axis is None else str(axis) for axis in self.shape)
        return f"{self.name} ({shape}) {self.type.removeprefix('tensor(').removesuffix(')')}"


@dataclasses.dataclass(frozen=True)
class Ports:
    """What a network takes and gives, in the order of the file."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]


def inspect(path: Path) -> Ports:
    """Check an ONNX file without running it.

    Args:
        path: the file; its data may lie in other files of its folder.

    Raises:
        ModelFileError: it is missing, empty, truncated, larger than 2 GB or no network; a tensor's data lie outside the
            folder, are missing, or are fewer than its shape declares; an operator is not one of onnxruntime's.
    """
    model = _parsed(path)
    own = {(function.domain, function.name) for function in model.functions}
    for node in _nodes(model):
        if node.domain not in DOMAINS and (node.domain, node.op_type) not in own:
            raise ModelFileError(
                f"{path} needs an operator that onnxruntime does not have: {node.domain}.{node.op_type}",
                expected=f"operators of {', '.join(sorted(DOMAINS - {''}))}",
                cure="export the network with the standard operators",
            )
        for attribute in node.attribute:
            _check_tensors(path, [attribute.t, *attribute.tensors] if attribute.HasField("t") else attribute.tensors)
            if attribute.HasField("sparse_tensor") or attribute.sparse_tensors:
                raise _sparse(path)
    for graph in _graphs(model):
        _check_tensors(path, graph.initializer)
        if graph.sparse_initializer:
            raise _sparse(path)
    held = {tensor.name for tensor in model.graph.initializer}
    inputs = [_port(value) for value in model.graph.input if value.name not in held]
    return Ports(tuple(inputs), tuple(map(_port, model.graph.output)))


def _parsed(path: Path) -> onnx.ModelProto:
    if not path.is_file():
        raise ModelFileError(f"{path} is missing", cure="name a file that is there")
    size = path.stat().st_size
    if size > LIMIT:
        raise ModelFileError(
            f"{path} is larger than an ONNX file can be", expected=f"at most {LIMIT} bytes", got=f"{size} bytes",
            cure="export the network with its weights as external data, in files beside it",
        )  # fmt: skip
    try:
        model = onnx.ModelProto.FromString(path.read_bytes())
    except DecodeError as error:
        raise ModelFileError(f"{path} is not a usable ONNX network, or a truncated one: {error}", cure=_CURE) from error
    # A protocol buffer has no mark of its kind: other bytes may parse, into nothing.
    if not (model.ir_version and model.opset_import and model.graph.node and model.graph.output):
        raise ModelFileError(
            f"{path} is not a usable ONNX network", expected="a graph with operators and outputs", cure=_CURE
        )
    return model


def _nodes(model: onnx.ModelProto) -> Iterator[onnx.NodeProto]:
    """Every operator, of functions and of graphs within operators too."""
    for function in model.functions:
        yield from function.node
    for graph in _graphs(model):
        yield from graph.node


def _graphs(model: onnx.ModelProto) -> Iterator[onnx.GraphProto]:
    """The graph, and every graph within an operator."""
    yield model.graph
    for nodes in (model.graph.node, *(function.node for function in model.functions)):
        for node in nodes:
            yield from _within(node)


def _within(node: onnx.NodeProto) -> Iterator[onnx.GraphProto]:
    for attribute in node.attribute:
        for graph in [attribute.g, *attribute.graphs] if attribute.HasField("g") else attribute.graphs:
            yield graph
            for inner in graph.node:
                yield from _within(inner)


def _port(value: onnx.ValueInfoProto) -> Port:
    kind = value.type.tensor_type
    name = TensorProto.DataType.Name(kind.elem_type).lower() if value.type.HasField("tensor_type") else "no tensor"
    if not kind.HasField("shape"):
        return Port(value.name, f"tensor({name})", None)
    shape = [axis.dim_value if axis.HasField("dim_value") else axis.dim_param or None for axis in kind.shape.dim]
    return Port(value.name, f"tensor({name})", tuple(shape))


def _check_tensors(path: Path, tensors: Iterable[TensorProto]) -> None:
    for tensor in tensors:
        if tensor.data_type not in TensorProto.DataType.values() or any(length < 0 for length in tensor.dims):
            raise ModelFileError(f"{path}: the constant {tensor.name} is malformed", got=_described(tensor), cure=_CURE)
        if tensor.data_location == TensorProto.EXTERNAL:
            held = _external_bytes(path, tensor) * 8 // _bits(tensor)
        else:
            held = _held(tensor)
        if math.prod(tensor.dims) > held:
            raise ModelFileError(
                f"{path}: the constant {tensor.name} declares more than its data, or the file is truncated",
                expected=f"{math.prod(tensor.dims)} values, {_described(tensor)}", got=f"{held} values", cure=_CURE,
            )  # fmt: skip


def _external_bytes(path: Path, tensor: TensorProto) -> int:
    """Bytes that a constant in another file has there; raises for a file that is not below the folder of ``path``."""
    entries = {entry.key: entry.value for entry in tensor.external_data}
    location, numbers = entries.get("location", ""), {key: entries.get(key, "0") for key in ("offset", "length")}
    relative = PurePosixPath(location)
    folder = path.resolve().parent
    data = folder / relative
    if not location or relative.is_absolute() or ".." in relative.parts or data.resolve() != data:
        raise ModelFileError(
            f"{path}: the data of the constant {tensor.name} are outside its folder",
            expected="a plain file in the folder of the network or below, not a link", got=repr(location),
            cure="copy network and data into one folder; a file that names other places must not be used",
        )  # fmt: skip
    if not data.is_file():
        raise ModelFileError(
            f"{path}: the data of the constant {tensor.name} are missing",
            expected=str(data), cure="bring the network together with the files beside it",
        )  # fmt: skip
    if not all(re.fullmatch(r"\d{1,18}", number) for number in numbers.values()):
        raise ModelFileError(
            f"{path}: the place of the constant {tensor.name} is malformed", got=str(numbers), cure=_CURE
        )
    there = max(data.stat().st_size - int(numbers["offset"]), 0)
    return min(there, int(numbers["length"])) if "length" in entries else there


def _held(tensor: TensorProto) -> int:
    """Values that a constant holds itself."""
    if tensor.HasField("raw_data"):
        return len(tensor.raw_data) * 8 // _bits(tensor)
    fields = (tensor.float_data, tensor.double_data, tensor.int32_data, tensor.int64_data, tensor.uint64_data)
    numbers = sum(map(len, fields)) + len(tensor.string_data)
    packed = max(8 // _bits(tensor), 1)  # int32_data has a byte of them in each number
    return numbers // 2 if _name(tensor).startswith("COMPLEX") else numbers * packed


def _bits(tensor: TensorProto) -> int:
    name = _name(tensor)
    if name in ("UNDEFINED", "STRING"):
        return 8
    return _PACKED.get(name) or 8 * onnx.helper.tensor_dtype_to_np_dtype(tensor.data_type).itemsize


def _name(tensor: TensorProto) -> str:
    return TensorProto.DataType.Name(tensor.data_type)


def _described(tensor: TensorProto) -> str:
    return f"{tuple(tensor.dims)} of type {tensor.data_type}"


def _sparse(path: Path) -> ModelFileError:
    return ModelFileError(f"{path} has sparse constants, whose size nothing bounds", cure="export dense weights")
