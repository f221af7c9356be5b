"""Operator rules, each against loops or a formula written here; the numbers of the real networks against LiteRT."""

from __future__ import annotations

import itertools

import numpy as np
import onnxruntime as ort
import pytest

from soar.errors import ModelFileError
from soar.models.convert import same_padding, to_onnx
from soar.models.tflite import Graph, Operator, Tensor
from tests.conftest import model_file

RNG = np.random.default_rng(5)
CONV = {"padding": 0, "stride_h": 1, "stride_w": 1, "dilation_h": 1, "dilation_w": 1, "activation": 0}


def run(
    kind: str, x: np.ndarray, out_shape: tuple[int, ...], constants: list[np.ndarray], **options: object
) -> np.ndarray:
    """Convert a graph of one operator and run it on ``x``."""
    tensors = [
        Tensor("in", x.shape),
        *(Tensor(f"c{i}", c.shape, c) for i, c in enumerate(constants)),
        Tensor("out", out_shape),
    ]
    last = len(tensors) - 1
    graph = Graph(tensors, [Operator(kind, tuple(range(last)), (last,), dict(options))], (0,), (last,))
    session = ort.InferenceSession(to_onnx(graph, "test").SerializeToString())
    (result,) = session.run(None, {"in": x})
    assert result.shape == out_shape
    return result


def floats(*shape: int) -> np.ndarray:
    return RNG.normal(size=shape).astype(np.float32)


def windows(x: np.ndarray, kernel: tuple[int, int], stride: int, dilation: int, same: bool, fill: float) -> np.ndarray:
    """(1, H', W', h, w, C) input cells under every window, by TFLite's definition of SAME and VALID."""
    pads = [(0, 0)] * 2
    if same:
        pads = []
        for size, k in zip(x.shape[1:3], kernel, strict=True):
            total = max((-(-size // stride) - 1) * stride + (k - 1) * dilation + 1 - size, 0)
            pads.append((total // 2, total - total // 2))
    x = np.pad(x, [(0, 0), *pads, (0, 0)], constant_values=fill)
    rows, columns = ((n - (k - 1) * dilation - 1) // stride + 1 for n, k in zip(x.shape[1:3], kernel, strict=True))
    out = np.zeros((1, rows, columns, *kernel, x.shape[3]), np.float32)
    for r, c, i, j in itertools.product(range(rows), range(columns), range(kernel[0]), range(kernel[1])):
        out[:, r, c, i, j] = x[:, r * stride + i * dilation, c * stride + j * dilation]
    return out


def test_same_padding_puts_the_odd_cell_after() -> None:
    assert same_padding(8, 3, 2, 1) == (0, 1)  # even input: the classic trap
    assert same_padding(7, 3, 2, 1) == (1, 1)
    assert same_padding(8, 3, 1, 2) == (2, 2)
    assert same_padding(5, 1, 2, 1) == (0, 0)  # never negative


@pytest.mark.parametrize(
    ("size", "stride", "dilation", "padding"), [(8, 2, 1, 0), (7, 2, 1, 0), (8, 1, 2, 0), (9, 2, 1, 1)]
)
def test_convolution(size: int, stride: int, dilation: int, padding: int) -> None:
    x, weights, bias = floats(1, size, size + 1, 3), floats(4, 3, 2, 3), floats(4)
    cells = windows(x, (3, 2), stride, dilation, padding == 0, 0.0)
    expected = np.einsum("brcijk,oijk->brco", cells, weights) + bias
    options = CONV | {"stride_h": stride, "stride_w": stride, "padding": padding}
    options |= {"dilation_h": dilation, "dilation_w": dilation}
    np.testing.assert_allclose(run("CONV_2D", x, expected.shape, [weights, bias], **options), expected, atol=2e-5)


@pytest.mark.parametrize(("code", "function"), [(1, lambda v: v.clip(0)), (3, lambda v: v.clip(0, 6))])
def test_fused_activation(code: int, function) -> None:
    x, weights = 5 * floats(1, 4, 4, 2), floats(3, 1, 1, 2)
    expected = function(np.einsum("brck,ok->brco", x, weights[:, 0, 0]))
    got = run("CONV_2D", x, expected.shape, [weights], **(CONV | {"activation": code}))
    np.testing.assert_allclose(got, expected, atol=1e-5)


def test_depthwise_convolution_with_channel_multiplier() -> None:
    x, weights, bias = floats(1, 6, 6, 3), floats(1, 3, 3, 6), floats(6)
    cells = windows(x, (3, 3), 2, 1, True, 0.0)
    expected = np.stack([(cells[..., o // 2] * weights[0, ..., o]).sum((-1, -2)) for o in range(6)], -1) + bias
    got = run("DEPTHWISE_CONV_2D", x, expected.shape, [weights, bias], **(CONV | {"stride_h": 2, "stride_w": 2}))
    np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.parametrize("size", [7, 8])
def test_max_pool(size: int) -> None:
    x = floats(1, size, size, 2) - 5  # below zero: padding must not win
    expected = windows(x, (3, 3), 2, 1, True, -np.inf).max(axis=(3, 4))
    options = {"padding": 0, "stride_h": 2, "stride_w": 2, "filter_h": 3, "filter_w": 3, "activation": 0}
    np.testing.assert_array_equal(run("MAX_POOL_2D", x, expected.shape, [], **options), expected)


def _resized(x: np.ndarray, size: int, align: bool, half: bool) -> np.ndarray:
    """TFLite's bilinear resize of both axes to ``size``, cell by cell."""
    n = x.shape[1]
    scale = (n - 1) / (size - 1) if align else n / size
    out = np.zeros((1, size, size, x.shape[3]), np.float32)
    for r, c in itertools.product(range(size), repeat=2):
        v, u = (max((i + 0.5) * scale - 0.5, 0.0) if half else i * scale for i in (r, c))
        r0, c0 = int(v), int(u)
        r1, c1 = min(r0 + 1, n - 1), min(c0 + 1, n - 1)
        top = x[0, r0, c0] * (1 - u + c0) + x[0, r0, c1] * (u - c0)
        bottom = x[0, r1, c0] * (1 - u + c0) + x[0, r1, c1] * (u - c0)
        out[0, r, c] = top * (1 - v + r0) + bottom * (v - r0)
    return out


@pytest.mark.parametrize(("align", "half"), [(False, False), (True, False), (False, True)])
@pytest.mark.parametrize("size", [8, 7])
def test_resize_modes(align: bool, half: bool, size: int) -> None:
    x = floats(1, 4, 4, 2)
    got = run(
        "RESIZE_BILINEAR",
        x,
        (1, size, size, 2),
        [np.array([size, size], np.int32)],
        align_corners=align,
        half_pixel=half,
    )
    np.testing.assert_allclose(got, _resized(x, size, align, half), atol=1e-5)


def test_depth_to_space() -> None:
    x = floats(1, 2, 3, 8)
    expected = np.zeros((1, 4, 6, 2), np.float32)
    for r, c, i, j in itertools.product(range(2), range(3), range(2), range(2)):
        expected[0, 2 * r + i, 2 * c + j] = x[0, r, c, (2 * i + j) * 2 : (2 * i + j) * 2 + 2]
    np.testing.assert_array_equal(run("DEPTH_TO_SPACE", x, expected.shape, [], block=2), expected)


def test_pad_prelu_and_add_keep_channels_last_meaning() -> None:
    """After a convolution values are channels first inside; constants and pads must follow."""
    x, weights, slope, shift = floats(1, 4, 5, 3), floats(3, 1, 1, 3), floats(1, 1, 3), floats(3)
    pads = np.array([[0, 0], [1, 2], [0, 1], [2, 0]], np.int32)
    tensors = [
        Tensor("in", x.shape), Tensor("w", weights.shape, weights), Tensor("conv", (1, 4, 5, 3)),
        Tensor("s", slope.shape, slope),
        Tensor("prelu", (1, 4, 5, 3)), Tensor("b", shift.shape, shift), Tensor("sum", (1, 4, 5, 3)),
        Tensor("p", pads.shape, pads), Tensor("out", (1, 7, 6, 5)),
    ]  # fmt: skip
    operators = [
        Operator("CONV_2D", (0, 1), (2,), CONV), Operator("PRELU", (2, 3), (4,)),
        Operator("ADD", (4, 5), (6,), {"activation": 0}), Operator("PAD", (6, 7), (8,)),
    ]  # fmt: skip
    model = to_onnx(Graph(tensors, operators, (0,), (8,)), "test")
    (got,) = ort.InferenceSession(model.SerializeToString()).run(None, {"in": x})
    y = np.einsum("brck,ok->brco", x, weights[:, 0, 0])
    expected = np.pad(np.where(y < 0, slope * y, y) + shift, pads)
    np.testing.assert_allclose(got, expected, atol=1e-5)
    assert sum(node.op_type == "Transpose" for node in model.graph.node) == 2  # one in, one out


def test_strided_slice_masks_and_steps() -> None:
    x = floats(1, 4, 6, 5)
    bounds = [np.array(v, np.int32) for v in ([0, 1, 5, 9], [1, 4, 1, 3], [1, 2, -2, 1])]
    masks = {"begin_mask": 0b1000, "end_mask": 0b0010, "ellipsis_mask": 0, "new_axis_mask": 0, "shrink_axis_mask": 0}
    expected = x[0:1, 1::2, 5:1:-2, :3]
    np.testing.assert_array_equal(run("STRIDED_SLICE", x, expected.shape, bounds, **masks), expected)
    with pytest.raises(ModelFileError, match="rank"):
        run("STRIDED_SLICE", x, expected.shape, bounds, **(masks | {"shrink_axis_mask": 1}))


def test_dense_layers() -> None:
    x, weights, bias = floats(1, 2, 2, 3), floats(5, 12), floats(5)
    got = run("FULLY_CONNECTED", x, (1, 5), [weights, bias], activation=0)
    np.testing.assert_allclose(got, x.reshape(1, 12) @ weights.T + bias, atol=1e-5)
    mean = run("MEAN", x, (1, 3), [np.array([1, 2], np.int32)], keep_dims=False)
    np.testing.assert_allclose(mean, x.mean(axis=(1, 2)), atol=1e-6)
    np.testing.assert_allclose(run("LOGISTIC", x, x.shape, []), 1 / (1 + np.exp(-x)), atol=1e-6)
    np.testing.assert_array_equal(run("RELU", x, x.shape, []), x.clip(0))
    np.testing.assert_array_equal(run("RESHAPE", x, (1, 4, 3), []), x.reshape(1, 4, 3))
    other = floats(1, 2, 2, 2)
    joined = run("CONCATENATION", x, (1, 2, 2, 5), [other], axis=3, activation=0)
    np.testing.assert_array_equal(joined, np.concatenate([x, other], axis=3))


def test_unknown_operators_and_activations_are_named() -> None:
    x = floats(1, 2, 2, 2)
    with pytest.raises(ModelFileError, match="CUSTOM:Landmarks"):
        run("CUSTOM:Landmarks", x, x.shape, [])
    with pytest.raises(ModelFileError, match="activation 4"):
        run("ADD", x, x.shape, [x], activation=4)


# Means of LiteRT 2.3.0's outputs for ``default_rng(0).random(shape)``, with the tolerance that float32 sums in another
# order need: for each output (mean, mean magnitude).
LITERT = {
    "pose_detection": [(0.72362598, 13.39893878), (-55.20653556, 55.20653556)],
    "pose_landmark_full": [
        (37.46802085, 47.18386384), (0.00265415, 0.00265415), (-61.96518246, 75.64483962), (-9.84096755, 9.84096755),
        (-0.11120551, 0.18098402),
    ],
    "hand_landmark_full": [
        (71.58912631, 71.58912631), (0.00764191, 0.00764191), (0.49312845, 0.49312845), (-0.00294982, 0.02010557),
    ],
    "hand_recrop": [(155.24903679, 155.24903679)],
    "face_detection_short_range": [(7.07362014, 13.10541656), (-7.78194599, 7.78194599)],
    "face_landmark": [(63.68902619, 67.05804089), (-10.57532787, 10.57532787)],
}  # fmt: skip


@pytest.mark.parametrize("name", LITERT)
def test_networks_agree_with_litert(name: str) -> None:
    session = ort.InferenceSession(model_file(f"{name}.onnx"))
    (source,) = session.get_inputs()
    outputs = session.run(None, {source.name: np.random.default_rng(0).random(source.shape, dtype=np.float32)})
    for output, (mean, magnitude) in zip(outputs, LITERT[name], strict=True):
        values = output.astype(np.float64)
        assert values.mean() == pytest.approx(mean, abs=2e-4 * magnitude)
        assert np.abs(values).mean() == pytest.approx(magnitude, rel=2e-4)
