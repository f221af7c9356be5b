"""Reading TFLite files: the graph, its operators and its constants as plain Python and numpy.

Only what image networks with float weights need is understood: float16 constants behind ``DEQUANTIZE`` and sparse
constants behind ``DENSIFY`` are decoded here, so that the graph returned has dense float32 constants and neither of
those operators. Layout follows TFLite: activations NHWC, convolution weights OHWI.
Format: TensorFlow ``lite/schema/schema.fbs``, version 3.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import tflite

from soar.errors import ModelFileError

_KINDS = {value: name for name, value in vars(tflite.BuiltinOperator).items() if isinstance(value, int)}
_DTYPES = {
    tflite.TensorType.FLOAT32: np.dtype("<f4"),
    tflite.TensorType.FLOAT16: np.dtype("<f2"),
    tflite.TensorType.INT32: np.dtype("<i4"),
    tflite.TensorType.INT64: np.dtype("<i8"),
}
_WINDOW = {"padding": "Padding", "stride_h": "StrideH", "stride_w": "StrideW", "activation": "FusedActivationFunction"}
_DILATION = {"dilation_h": "DilationHFactor", "dilation_w": "DilationWFactor"}
# Per operator: the flatbuffers class of its options, and our name of each option read.
_OPTIONS: dict[str, tuple[type, dict[str, str]]] = {
    "CONV_2D": (tflite.Conv2DOptions, _WINDOW | _DILATION),
    "DEPTHWISE_CONV_2D": (tflite.DepthwiseConv2DOptions, _WINDOW | _DILATION),
    "MAX_POOL_2D": (tflite.Pool2DOptions, _WINDOW | {"filter_h": "FilterHeight", "filter_w": "FilterWidth"}),
    "ADD": (tflite.AddOptions, {"activation": "FusedActivationFunction"}),
    "CONCATENATION": (tflite.ConcatenationOptions, {"axis": "Axis", "activation": "FusedActivationFunction"}),
    "FULLY_CONNECTED": (tflite.FullyConnectedOptions, {"activation": "FusedActivationFunction"}),
    "RESIZE_BILINEAR": (
        tflite.ResizeBilinearOptions,
        {"align_corners": "AlignCorners", "half_pixel": "HalfPixelCenters"},
    ),
    "DEPTH_TO_SPACE": (tflite.DepthToSpaceOptions, {"block": "BlockSize"}),
    "MEAN": (tflite.ReducerOptions, {"keep_dims": "KeepDims"}),
    "STRIDED_SLICE": (
        tflite.StridedSliceOptions,
        {
            "begin_mask": "BeginMask",
            "end_mask": "EndMask",
            "ellipsis_mask": "EllipsisMask",
            "new_axis_mask": "NewAxisMask",
            "shrink_axis_mask": "ShrinkAxisMask",
        },
    ),
}


@dataclasses.dataclass
class Tensor:
    """An activation (``data`` is None) or a constant of the graph, in TFLite layout."""

    name: str
    shape: tuple[int, ...]
    data: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Operator:
    """One node: TFLite operator name, tensor indices (-1 = absent optional input), and its options."""

    kind: str
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    options: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass
class Graph:
    """A feed-forward network in execution order."""

    tensors: list[Tensor]
    operators: list[Operator]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class SparseLevel:
    """One level of TFLite's sparse storage: dense of ``size``, or compressed by ``segments`` and ``indices``."""

    size: int
    segments: np.ndarray | None = None
    indices: np.ndarray | None = None


def read_graph(content: bytes, name: str) -> Graph:
    """Parse a TFLite file with a single subgraph.

    Args:
        content: the bytes of the file.
        name: its name, for messages.

    Raises:
        ModelFileError: not a TFLite file, damaged, or using a feature that is not understood.
    """
    if not tflite.Model.ModelBufferHasIdentifier(content, 0):
        raise ModelFileError(f"{name} is not a TFLite model", expected="file identifier TFL3", got=repr(content[4:8]))
    try:
        return _read_graph(content, name)
    # What flatbuffers and numpy raise when an offset or a length of a damaged file points nowhere.
    except (struct.error, IndexError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ModelFileError(
            f"{name} cannot be parsed as TFLite: {error}", cure="delete the file and fetch it again"
        ) from error


def _read_graph(content: bytes, name: str) -> Graph:
    model = tflite.Model.GetRootAsModel(content, 0)
    if model.SubgraphsLength() != 1:
        raise ModelFileError(f"{name} has control flow", expected="1 subgraph", got=f"{model.SubgraphsLength()}")
    source = model.Subgraphs(0)
    graph = Graph(
        [_read_tensor(model, source.Tensors(i), name) for i in range(source.TensorsLength())],
        [],
        tuple(source.InputsAsNumpy().tolist()),
        tuple(source.OutputsAsNumpy().tolist()),
    )
    for i in range(source.OperatorsLength()):
        operator = _read_operator(model, source.Operators(i))
        if operator.kind in ("DEQUANTIZE", "DENSIFY"):
            data = graph.tensors[operator.inputs[0]].data
            if data is None:
                raise ModelFileError(
                    f"{name} is quantised", expected="float weights", got=f"{operator.kind} at run time"
                )
            # Expanded float16 stays float16 until its DEQUANTIZE.
            graph.tensors[operator.outputs[0]].data = data if operator.kind == "DENSIFY" else data.astype(np.float32)
        else:
            graph.operators.append(operator)
    return graph


def _read_operator(model: tflite.Model, source: tflite.Operator) -> Operator:
    code = model.OperatorCodes(source.OpcodeIndex())
    # Old files keep small codes in the deprecated field; the larger of the two is the code.
    kind = _KINDS[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
    if kind == "CUSTOM":
        kind = f"CUSTOM:{code.CustomCode().decode()}"
    options: dict[str, Any] = {}
    if kind in _OPTIONS:
        cls, fields = _OPTIONS[kind]
        table, reader = source.BuiltinOptions(), cls()
        reader.Init(table.Bytes, table.Pos)
        options = {ours: getattr(reader, theirs)() for ours, theirs in fields.items()}
    return Operator(kind, tuple(source.InputsAsNumpy().tolist()), tuple(source.OutputsAsNumpy().tolist()), options)


def _read_tensor(model: tflite.Model, source: tflite.Tensor, name: str) -> Tensor:
    shape = tuple(source.ShapeAsNumpy().tolist()) if source.ShapeLength() else ()
    tensor = Tensor(source.Name().decode(), shape)
    if model.Buffers(source.Buffer()).DataLength() == 0:
        return tensor
    if source.Type() not in _DTYPES:
        raise ModelFileError(
            f"{name}: constant {tensor.name} has TFLite type {source.Type()}", expected="float or integer"
        )
    values = model.Buffers(source.Buffer()).DataAsNumpy().view(_DTYPES[source.Type()])
    sparsity = source.Sparsity()
    if sparsity is None:
        tensor.data = values.reshape(shape)
    else:
        order = sparsity.TraversalOrderAsNumpy().tolist()
        blocks = sparsity.BlockMapAsNumpy().tolist() if sparsity.BlockMapLength() else []
        levels = [_read_level(sparsity.DimMetadata(i)) for i in range(sparsity.DimMetadataLength())]
        tensor.data = decode_sparse(values, shape, order, blocks, levels)
    return tensor


def _read_level(source: tflite.DimensionMetadata) -> SparseLevel:
    if source.Format() == tflite.DimensionType.DENSE:
        return SparseLevel(source.DenseSize())

    def vector(kind: int, table: Any) -> np.ndarray:
        readers = {1: tflite.Int32Vector, 2: tflite.Uint16Vector, 3: tflite.Uint8Vector}
        reader = readers[kind]()
        reader.Init(table.Bytes, table.Pos)
        return reader.ValuesAsNumpy().astype(np.int64)

    return SparseLevel(
        0,
        vector(source.ArraySegmentsType(), source.ArraySegments()),
        vector(source.ArrayIndicesType(), source.ArrayIndices()),
    )


def decode_sparse(
    values: np.ndarray, shape: Sequence[int], order: Sequence[int], blocks: Sequence[int], levels: Sequence[SparseLevel]
) -> np.ndarray:
    """Expand TFLite's sparse tensor storage to a dense array.

    Args:
        values: (n,) stored values in storage order.
        shape: the dense shape, rank r.
        order: the dimension stored at each level; r + k is the k-th block dimension.
        blocks: for the k-th block dimension, the dimension it subdivides.
        levels: one storage level per entry of ``order``.

    Raises:
        ValueError: the levels do not account for exactly ``n`` values.
    """
    rank = len(shape)
    block_size = {blocks[d - rank]: levels[i].size for i, d in enumerate(order) if d >= rank}
    # Walk the levels, keeping for every stored position its coordinates; the order of rows is the storage order.
    coordinates = np.zeros((1, rank + len(blocks)), np.int64)
    position = np.zeros(1, np.int64)
    for dimension, level in zip(order, levels, strict=True):
        if level.segments is None or level.indices is None:
            count = np.full(len(position), level.size)
            index = np.tile(np.arange(level.size), len(position))
            following = (position[:, None] * level.size + np.arange(level.size)).ravel()
        else:
            start, stop = level.segments[position], level.segments[position + 1]
            count = stop - start
            following = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)] or [start])
            index = level.indices[following]
        coordinates = np.repeat(coordinates, count, axis=0)
        coordinates[:, dimension] = index
        position = following
    if len(position) != len(values):
        raise ValueError(f"sparse constant holds {len(values)} values for {len(position)} places")
    element = coordinates[:, :rank].copy()
    for k, dimension in enumerate(blocks):
        element[:, dimension] = element[:, dimension] * block_size[dimension] + coordinates[:, rank + k]
    dense = np.zeros(tuple(shape), values.dtype)
    dense[tuple(element.T)] = values
    return dense
