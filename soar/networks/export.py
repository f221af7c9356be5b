"""From a trained network to a small ONNX file with its record, checked against the network it was made of.

Weights are stored in half precision and widened when the file is loaded; nothing is computed in half precision.
"""

from __future__ import annotations

import copy
import io
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from soar.artifacts import atomic_path
from soar.errors import ModelFileError
from soar.models import records
from soar.models.onnx import Shape, Signature, session

OPSET = 17
TOLERANCE = 1e-3  # largest difference between the file and the network with the same rounded weights


def export(network: nn.Module, signature: Signature, side: int, path: Path, facts: Mapping[str, Any]) -> None:
    """Write ``network`` to ``path`` and its record beside it.

    Args:
        network: takes the tensors of ``signature.inputs`` in order and returns those of the outputs.
        signature: names and shapes; the first axis is the batch, free ones among the last two are height and width.
        side: height and width to trace and check at; where they are free, twice the height is checked too.
        path: the ``.onnx`` file to write.
        facts: what the record says besides: licence, training, figures.

    Raises:
        ModelFileError: the file does not compute what the network computes, within 1e-3 for a batch of 1 and of 2.
        StorageError: the disk is full or not writable.
    """
    rounded = copy.deepcopy(network).cpu().eval()
    for value in rounded.state_dict().values():
        if value.is_floating_point():
            value.copy_(value.half().float())
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # The exporter warns that it is the older one; its replacement needs two packages more and gives the same graph.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            rounded,
            tuple(_noise(signature, 1, side, side)),
            buffer,
            opset_version=OPSET,
            dynamo=False,
            input_names=list(signature.inputs),
            output_names=list(signature.outputs),
            dynamic_axes={name: _free(shape) for name, shape in {**signature.inputs, **signature.outputs}.items()},
        )
    with atomic_path(path) as temporary:
        temporary.write_bytes(_half(onnx.load_from_string(buffer.getvalue())).SerializeToString())
        worst = difference(rounded, signature, temporary, side)
        if not worst <= TOLERANCE:  # NaN is no agreement
            raise ModelFileError(
                f"{path} would not compute what the network does",
                expected=f"outputs equal to {TOLERANCE:g}",
                got=f"a difference of {worst:.2g}",
                cure="report this with the versions of torch, onnx and onnxruntime",
            )
    shapes = {"inputs": dict(signature.inputs), "outputs": dict(signature.outputs)}
    parameters = sum(value.numel() for value in network.parameters())
    checked = {"opset": OPSET, "parameters": parameters, "difference_to_torch": worst}
    records.write(path.parent, path.name, {**facts, **shapes, **checked})


def difference(network: nn.Module, signature: Signature, path: Path, side: int) -> float:
    """Largest absolute difference between file and network on noise: a batch of 1, and of 2 at twice the height."""
    opened = session(path, 1, signature)
    differences = []
    for count, height, width in ((1, side, side), (2, 2 * side, side)):
        inputs = _noise(signature, count, height, width)
        with torch.inference_mode():
            expected = network(*inputs)
        feed = {name: value.numpy() for name, value in zip(signature.inputs, inputs, strict=True)}
        got = opened.run(list(signature.outputs), feed)
        differences += [np.abs(a.numpy() - b).max() for a, b in zip(expected, got, strict=True)]
    return float(np.max(differences))  # NaN if any is


def _noise(signature: Signature, count: int, height: int, width: int) -> list[Tensor]:
    """Normal noise for pictures; what has one axis is a time in [0, 1], what has two are flags, set in every second
    sample from the first: at values between, a network need not do anything of interest."""
    generator = torch.Generator().manual_seed(count)
    sizes = {"batch": count, "height": height, "width": width}
    drawn = []
    for free in signature.inputs.values():
        shape = [sizes[_free(free)[axis]] if length is None else length for axis, length in enumerate(free)]
        if len(shape) == 1:
            drawn.append(torch.rand(shape, generator=generator))
        elif len(shape) == 2:
            drawn.append((1.0 - torch.arange(count)[:, None] % 2).expand(shape))
        else:
            drawn.append(torch.randn(shape, generator=generator))
    return drawn


def _free(shape: Shape) -> dict[int, str]:
    """Names of the free axes: the first is the batch, the last two are height and width."""
    names = {len(shape) - 2: "height", len(shape) - 1: "width", 0: "batch"}
    return {axis: names[axis] for axis, length in enumerate(shape) if length is None}


def _half(model: onnx.ModelProto) -> onnx.ModelProto:
    """Store each float32 initialiser that half precision holds exactly in half the bytes, and a node that widens it."""
    casts = []
    for tensor in model.graph.initializer:
        if tensor.data_type != TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(tensor)
        if values.size < 2 or not np.array_equal(values.astype(np.float16).astype(np.float32), values):
            continue
        name = tensor.name
        tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
        casts.append(helper.make_node("Cast", [tensor.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model
