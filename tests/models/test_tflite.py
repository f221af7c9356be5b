"""The reader on a TFLite file built here, and sparse storage against the dense arrays it came from."""

from __future__ import annotations

import flatbuffers
import numpy as np
import onnxruntime as ort
import pytest
import tflite

from soar.errors import ModelFileError
from soar.models.convert import convert
from soar.models.tflite import SparseLevel, decode_sparse, read_graph

WEIGHTS = np.arange(1, 7, dtype=np.float16).reshape(2, 1, 1, 3) / 8


def tiny_tflite() -> bytes:
    """x (1, 2, 2, 3) -> DEQUANTIZE(float16 weights) -> CONV_2D 1x1 with ReLU -> y (1, 2, 2, 2)."""
    b = flatbuffers.Builder(1024)

    def vector(start, values, prepend) -> int:
        start(b, len(values))
        for value in reversed(values):
            prepend(value)
        return b.EndVector()

    def tensor(name: str, shape: list[int], kind: int, buffer: int) -> int:
        name_at = b.CreateString(name)
        shape_at = vector(tflite.TensorStartShapeVector, shape, b.PrependInt32)
        tflite.TensorStart(b)
        tflite.TensorAddShape(b, shape_at)
        tflite.TensorAddType(b, kind)
        tflite.TensorAddBuffer(b, buffer)
        tflite.TensorAddName(b, name_at)
        return tflite.TensorEnd(b)

    def operator(code: int, inputs: list[int], outputs: list[int], options: int | None) -> int:
        inputs_at = vector(tflite.OperatorStartInputsVector, inputs, b.PrependInt32)
        outputs_at = vector(tflite.OperatorStartOutputsVector, outputs, b.PrependInt32)
        tflite.OperatorStart(b)
        tflite.OperatorAddOpcodeIndex(b, code)
        tflite.OperatorAddInputs(b, inputs_at)
        tflite.OperatorAddOutputs(b, outputs_at)
        if options is not None:
            tflite.OperatorAddBuiltinOptionsType(b, tflite.BuiltinOptions.Conv2DOptions)
            tflite.OperatorAddBuiltinOptions(b, options)
        return tflite.OperatorEnd(b)

    def code(kind: int) -> int:
        tflite.OperatorCodeStart(b)
        tflite.OperatorCodeAddDeprecatedBuiltinCode(b, kind)  # as old files do
        return tflite.OperatorCodeEnd(b)

    data_at = b.CreateByteVector(WEIGHTS.tobytes())
    buffers = []
    for data in (None, data_at):
        tflite.BufferStart(b)
        if data is not None:
            tflite.BufferAddData(b, data)
        buffers.append(tflite.BufferEnd(b))
    f32, f16 = tflite.TensorType.FLOAT32, tflite.TensorType.FLOAT16
    tensors = [
        tensor("x", [1, 2, 2, 3], f32, 0), tensor("w16", [2, 1, 1, 3], f16, 1), tensor("w", [2, 1, 1, 3], f32, 0),
        tensor("y", [1, 2, 2, 2], f32, 0),
    ]  # fmt: skip
    tflite.Conv2DOptionsStart(b)
    tflite.Conv2DOptionsAddPadding(b, 1)
    tflite.Conv2DOptionsAddStrideH(b, 1)
    tflite.Conv2DOptionsAddStrideW(b, 1)
    tflite.Conv2DOptionsAddFusedActivationFunction(b, 1)
    options = tflite.Conv2DOptionsEnd(b)
    operators = [operator(0, [1], [2], None), operator(1, [0, 2, -1], [3], options)]
    codes = [code(tflite.BuiltinOperator.DEQUANTIZE), code(tflite.BuiltinOperator.CONV_2D)]
    tensors_at = vector(tflite.SubGraphStartTensorsVector, tensors, b.PrependUOffsetTRelative)
    inputs_at = vector(tflite.SubGraphStartInputsVector, [0], b.PrependInt32)
    outputs_at = vector(tflite.SubGraphStartOutputsVector, [3], b.PrependInt32)
    operators_at = vector(tflite.SubGraphStartOperatorsVector, operators, b.PrependUOffsetTRelative)
    tflite.SubGraphStart(b)
    tflite.SubGraphAddTensors(b, tensors_at)
    tflite.SubGraphAddInputs(b, inputs_at)
    tflite.SubGraphAddOutputs(b, outputs_at)
    tflite.SubGraphAddOperators(b, operators_at)
    graphs_at = vector(tflite.ModelStartSubgraphsVector, [tflite.SubGraphEnd(b)], b.PrependUOffsetTRelative)
    codes_at = vector(tflite.ModelStartOperatorCodesVector, codes, b.PrependUOffsetTRelative)
    buffers_at = vector(tflite.ModelStartBuffersVector, buffers, b.PrependUOffsetTRelative)
    tflite.ModelStart(b)
    tflite.ModelAddVersion(b, 3)
    tflite.ModelAddOperatorCodes(b, codes_at)
    tflite.ModelAddSubgraphs(b, graphs_at)
    tflite.ModelAddBuffers(b, buffers_at)
    b.Finish(tflite.ModelEnd(b), b"TFL3")
    return bytes(b.Output())


def test_reads_graph_and_expands_half_precision_weights() -> None:
    graph = read_graph(tiny_tflite(), "tiny")
    assert [op.kind for op in graph.operators] == ["CONV_2D"]
    assert graph.operators[0].options["activation"] == 1
    assert graph.tensors[2].data.dtype == np.float32
    np.testing.assert_array_equal(graph.tensors[2].data, WEIGHTS.astype(np.float32))
    assert (graph.tensors[0].name, graph.tensors[0].shape) == ("x", (1, 2, 2, 3))


def test_conversion_computes_the_same_and_always_the_same_bytes() -> None:
    content = convert(tiny_tflite(), "tiny")
    assert content == convert(tiny_tflite(), "tiny")
    x = np.linspace(-1, 1, 12, dtype=np.float32).reshape(1, 2, 2, 3)
    (y,) = ort.InferenceSession(content).run(["y"], {"x": x})
    np.testing.assert_allclose(y, (x @ WEIGHTS[:, 0, 0].astype(np.float32).T).clip(0), atol=1e-6)


def test_other_and_damaged_files_are_refused() -> None:
    with pytest.raises(ModelFileError, match="not a TFLite model"):
        read_graph(b"PK\x03\x04 something else", "archive")
    whole = tiny_tflite()
    for keep in (12, len(whole) // 3, len(whole) // 2):
        with pytest.raises(ModelFileError, match=r"parsed|parse|subgraph"):
            convert(whole[:keep], "short")


def _csr(dense: np.ndarray) -> tuple[np.ndarray, SparseLevel]:
    """Values and compressed level of the last axis of a 2-D array."""
    rows = [np.flatnonzero(row) for row in dense]
    segments = np.cumsum([0, *map(len, rows)])
    return dense[dense != 0], SparseLevel(0, segments, np.concatenate(rows))


def test_sparse_matrix() -> None:
    dense = np.array([[0, 3, 0, 1], [0, 0, 0, 0], [5, 0, 0, 7]], np.float16)
    values, level = _csr(dense)
    np.testing.assert_array_equal(decode_sparse(values, dense.shape, [0, 1], [], [SparseLevel(3), level]), dense)
    # Column-major traversal of the same matrix.
    values, level = _csr(dense.T)
    np.testing.assert_array_equal(decode_sparse(values, dense.shape, [1, 0], [], [SparseLevel(4), level]), dense)


def test_sparse_blocks() -> None:
    """1x2 blocks: block columns compressed, each holding two neighbours (as in the person detector)."""
    dense = np.array([[1, 2, 0, 0, 3, 4], [0, 0, 5, 6, 0, 0]], np.float32)
    levels = [SparseLevel(2), SparseLevel(0, np.array([0, 2, 3]), np.array([0, 2, 1])), SparseLevel(2)]
    got = decode_sparse(np.arange(1, 7, dtype=np.float32), dense.shape, [0, 1, 2], [1], levels)
    np.testing.assert_array_equal(got, dense)


def test_sparse_storage_must_account_for_every_value() -> None:
    dense = np.eye(3, dtype=np.float32)
    values, level = _csr(dense)
    with pytest.raises(ValueError, match="holds 2 values for 3 places"):
        decode_sparse(values[:2], dense.shape, [0, 1], [], [SparseLevel(3), level])
