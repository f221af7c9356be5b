"""TFLite graphs to ONNX (opset 17), exactly: the same arithmetic, float32, batch 1.

ONNX convolutions want channels first while TFLite keeps them last, so every 4-D value may exist in two layouts and a
transpose is inserted only where the other one is asked for. Inputs and outputs keep TFLite's names and NHWC layout.
The bytes written are a function of the bytes read.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from soar.errors import ModelFileError
from soar.models.tflite import Graph, Operator, read_graph

VERSION = "1"  # of these rules; part of every manifest entry, so that a change of the rules converts again
OPSET, IR_VERSION = 17, 8

Layout = Literal["last", "first"]
_PERMUTE = {"first": (0, 3, 1, 2), "last": (0, 2, 3, 1)}
_SAME = 0  # schema.fbs, enum Padding


def convert(content: bytes, name: str) -> bytes:
    """Convert the bytes of a TFLite file to the bytes of an ONNX file.

    Raises:
        ModelFileError: the file is damaged or uses an operator without a rule.
    """
    model = to_onnx(read_graph(content, name), name)
    return model.SerializeToString(deterministic=True)


def to_onnx(graph: Graph, name: str) -> onnx.ModelProto:
    """Convert a graph; raises :class:`ModelFileError` for an operator or option without a rule."""
    builder = _Builder(graph, name)
    for operator in graph.operators:
        rule = _RULES.get(operator.kind)
        if rule is None:
            raise ModelFileError(
                f"{name} uses the TFLite operator {operator.kind}", expected="one of " + ", ".join(sorted(_RULES))
            )
        rule(builder, operator)
    return builder.finish()


def same_padding(size: int, kernel: int, stride: int, dilation: int) -> tuple[int, int]:
    """TFLite's SAME padding of one axis: cells before and after, the odd cell after."""
    out = -(-size // stride)
    total = max(0, (out - 1) * stride + (kernel - 1) * dilation + 1 - size)
    return total // 2, total - total // 2


class _Builder:
    """The ONNX graph under construction and the layouts in which each TFLite tensor already exists."""

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self.values: dict[tuple[int, Layout], str] = {(i, "last"): graph.tensors[i].name for i in graph.inputs}

    def node(self, kind: str, inputs: list[str], **attributes: Any) -> str:
        output = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def constant(self, value: np.ndarray) -> str:
        name = f"constant_{len(self.initializers)}"
        self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def shape(self, index: int) -> tuple[int, ...]:
        return self.graph.tensors[index].shape

    def data(self, operator: Operator, slot: int) -> np.ndarray:
        data = self.graph.tensors[operator.inputs[slot]].data
        if data is None:
            raise ModelFileError(f"{self.name}: input {slot} of {operator.kind} is computed", expected="a constant")
        return data

    def layout(self, *indices: int) -> Layout:
        """The layout that needs fewest transposes: channels first if a 4-D operand already is."""
        return "first" if any((i, "first") in self.values for i in indices) else "last"

    def get(self, index: int, layout: Layout) -> str:
        """ONNX name of a tensor in a layout, transposing or embedding a constant when it is not there yet."""
        if (index, layout) not in self.values:
            data = self.graph.tensors[index].data
            if data is not None:
                if layout == "first":  # trailing axes broadcast in TFLite: complete them before moving channels
                    data = data.reshape((1,) * (4 - data.ndim) + data.shape).transpose(_PERMUTE["first"])
                self.values[index, layout] = self.constant(data)
            else:
                other = self.values[index, "last" if layout == "first" else "first"]
                self.values[index, layout] = self.node("Transpose", [other], perm=_PERMUTE[layout])
        return self.values[index, layout]

    def put(self, operator: Operator, layout: Layout, value: str) -> None:
        """Record the operator's output, after its fused activation."""
        activation = operator.options.get("activation", 0)
        if activation == 1:
            value = self.node("Relu", [value])
        elif activation == 3:
            value = self.node("Clip", [value, self.constant(np.float32(0)), self.constant(np.float32(6))])
        elif activation != 0:
            raise ModelFileError(f"{self.name}: fused activation {activation} of {operator.kind}", expected="0, 1 or 3")
        self.values[operator.outputs[0], layout] = value

    def window(self, operator: Operator, kernel: tuple[int, int]) -> dict[str, list[int]]:
        """Stride, dilation and explicit padding attributes of a convolution or pooling."""
        o = operator.options
        strides, dilations = (o["stride_h"], o["stride_w"]), (o.get("dilation_h", 1), o.get("dilation_w", 1))
        pads = [0, 0, 0, 0]
        if o["padding"] == _SAME:
            size = self.shape(operator.inputs[0])[1:3]
            (top, bottom), (left, right) = (same_padding(size[i], kernel[i], strides[i], dilations[i]) for i in (0, 1))
            pads = [top, left, bottom, right]
        return {"kernel_shape": list(kernel), "strides": list(strides), "dilations": list(dilations), "pads": pads}

    def finish(self) -> onnx.ModelProto:
        def info(i: int) -> onnx.ValueInfoProto:
            return helper.make_tensor_value_info(self.graph.tensors[i].name, TensorProto.FLOAT, self.shape(i))

        for i in self.graph.outputs:
            name = self.graph.tensors[i].name
            self.nodes.append(helper.make_node("Identity", [self.get(i, "last")], [name], name=f"output_{name}"))
        graph = helper.make_graph(
            self.nodes, self.name, [info(i) for i in self.graph.inputs], [info(i) for i in self.graph.outputs],
            self.initializers,
        )  # fmt: skip
        model = helper.make_model(
            graph, producer_name="soar", producer_version=VERSION, opset_imports=[helper.make_opsetid("", OPSET)]
        )
        model.ir_version = IR_VERSION
        onnx.checker.check_model(model)
        return model


def _convolution(b: _Builder, op: Operator, depthwise: bool) -> None:
    weights = b.data(op, 1)
    kernel = (weights.shape[1], weights.shape[2])
    # OHWI, or 1HW(IM) for depthwise, to OIHW.
    weights = weights.transpose((3, 0, 1, 2) if depthwise else (0, 3, 1, 2))
    inputs = [b.get(op.inputs[0], "first"), b.constant(weights)]
    if len(op.inputs) > 2 and op.inputs[2] >= 0:
        inputs.append(b.constant(b.data(op, 2)))
    group = b.shape(op.inputs[0])[3] if depthwise else 1
    b.put(op, "first", b.node("Conv", inputs, group=group, **b.window(op, kernel)))


def _max_pool(b: _Builder, op: Operator) -> None:
    window = b.window(op, (op.options["filter_h"], op.options["filter_w"]))
    b.put(op, "first", b.node("MaxPool", [b.get(op.inputs[0], "first")], **window))


def _elementwise(kind: str) -> Callable[[_Builder, Operator], None]:
    def rule(b: _Builder, op: Operator) -> None:
        layout = b.layout(*op.inputs)
        b.put(op, layout, b.node(kind, [b.get(i, layout) for i in op.inputs]))

    return rule


def _pad(b: _Builder, op: Operator) -> None:
    pads = b.data(op, 1).astype(np.int64)
    layout = b.layout(op.inputs[0])
    if layout == "first":
        pads = pads[list(_PERMUTE["first"])]
    b.put(op, layout, b.node("Pad", [b.get(op.inputs[0], layout), b.constant(pads.T.ravel())], mode="constant"))


def _resize_bilinear(b: _Builder, op: Operator) -> None:
    batch, _, _, channels = b.shape(op.inputs[0])
    sizes = np.array([batch, channels, *b.data(op, 1)], np.int64)
    mode = (
        "align_corners" if op.options["align_corners"] else "half_pixel" if op.options["half_pixel"] else "asymmetric"
    )
    inputs = [b.get(op.inputs[0], "first"), "", "", b.constant(sizes)]
    b.put(op, "first", b.node("Resize", inputs, mode="linear", coordinate_transformation_mode=mode))


def _depth_to_space(b: _Builder, op: Operator) -> None:
    x = b.get(op.inputs[0], "first")
    b.put(op, "first", b.node("DepthToSpace", [x], blocksize=op.options["block"], mode="DCR"))


def _reshape(b: _Builder, op: Operator) -> None:
    shape = b.constant(np.array(b.shape(op.outputs[0]), np.int64))
    b.put(op, "last", b.node("Reshape", [b.get(op.inputs[0], "last"), shape]))


def _concatenation(b: _Builder, op: Operator) -> None:
    b.put(op, "last", b.node("Concat", [b.get(i, "last") for i in op.inputs], axis=op.options["axis"]))


def _mean(b: _Builder, op: Operator) -> None:
    axes, keep = b.data(op, 1).ravel().tolist(), int(op.options["keep_dims"])
    b.put(op, "last", b.node("ReduceMean", [b.get(op.inputs[0], "last")], axes=axes, keepdims=keep))


def _strided_slice(b: _Builder, op: Operator) -> None:
    o = op.options
    if o["ellipsis_mask"] or o["new_axis_mask"] or o["shrink_axis_mask"]:
        raise ModelFileError(f"{b.name}: STRIDED_SLICE changes the rank", expected="begin and end masks only")
    begin, end, stride = (b.data(op, k).astype(np.int64) for k in (1, 2, 3))
    limits = np.iinfo(np.int64)
    for axis in range(len(begin)):  # a masked bound means "from the first" or "to the last" in stride direction
        if o["begin_mask"] >> axis & 1:
            begin[axis] = 0 if stride[axis] > 0 else limits.max
        if o["end_mask"] >> axis & 1:
            end[axis] = limits.max if stride[axis] > 0 else limits.min
    axes = np.arange(len(begin), dtype=np.int64)
    inputs = [b.get(op.inputs[0], "last"), *map(b.constant, (begin, end, axes, stride))]
    b.put(op, "last", b.node("Slice", inputs))


def _fully_connected(b: _Builder, op: Operator) -> None:
    weights = b.data(op, 1)
    rows = b.node("Reshape", [b.get(op.inputs[0], "last"), b.constant(np.array([-1, weights.shape[1]], np.int64))])
    inputs = [rows, b.constant(weights)]
    if len(op.inputs) > 2 and op.inputs[2] >= 0:
        inputs.append(b.constant(b.data(op, 2)))
    product = b.node("Gemm", inputs, transB=1)
    shape = b.constant(np.array(b.shape(op.outputs[0]), np.int64))
    b.put(op, "last", b.node("Reshape", [product, shape]))


_RULES: dict[str, Callable[[_Builder, Operator], None]] = {
    "CONV_2D": lambda b, op: _convolution(b, op, depthwise=False),
    "DEPTHWISE_CONV_2D": lambda b, op: _convolution(b, op, depthwise=True),
    "MAX_POOL_2D": _max_pool,
    "ADD": _elementwise("Add"),
    "RELU": _elementwise("Relu"),
    "LOGISTIC": _elementwise("Sigmoid"),
    "PRELU": _elementwise("PRelu"),
    "PAD": _pad,
    "RESIZE_BILINEAR": _resize_bilinear,
    "DEPTH_TO_SPACE": _depth_to_space,
    "RESHAPE": _reshape,
    "CONCATENATION": _concatenation,
    "MEAN": _mean,
    "STRIDED_SLICE": _strided_slice,
    "FULLY_CONNECTED": _fully_connected,
}
