"""A sphere whose normals are known, as crops of whole frames, and normal networks of the documented layouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from soar.perception.normals import Context, Crop
from soar.raster import Pinhole
from tests.raster.scenes import VIEW, sphere

FRAME = (200, 160)
"""Width and height of the whole frames, pixels."""

AT = (70, 50)
"""Where in it the crop begins: the sphere is left of the frame's middle by half a pixel, so a mirrored map shows."""


def crop(frame: int = 0, **changes: object) -> Crop:
    """A crop of :data:`VIEW` with the sphere in it; the mask is where the sphere is."""
    vertices, faces = sphere()
    height, width = VIEW.height, VIEW.width
    values = {
        "rgb": np.full((height, width, 3), 90, np.uint8),
        "alpha": np.uint8(255 * (np.abs(truth("front")).max(-1) > 0)),
        "vertices": vertices, "faces": faces, "pinhole": VIEW, "frame": frame,
        "box": (AT[0], AT[1], AT[0] + width, AT[1] + height), "size": FRAME,
    }  # fmt: skip
    return Crop(**(values | changes))


def truth(side: str, view: Pinhole = VIEW) -> np.ndarray:
    """Normals (H, W, 3) of the sphere of radius 0.5 about (0, 0, 3), zero beyond it."""
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    ray = np.stack([(columns - view.cx) / view.fx, (rows - view.cy) / view.fy, np.ones(rows.shape)], -1)
    a, discriminant = (ray**2).sum(-1), 9 - (ray**2).sum(-1) * 8.75
    depth = (3 + (-1 if side == "front" else 1) * np.sqrt(np.maximum(discriminant, 0))) / a
    return np.where(discriminant[..., None] > 0, (ray * depth[..., None] - [0, 0, 3]) / 0.5, 0).astype(np.float32)


def whole(side: str) -> np.ndarray:
    """Normals of the whole frame, (160, 200, 3)."""
    return truth(side, Pinhole(VIEW.fx, VIEW.fy, VIEW.cx + AT[0], VIEW.cy + AT[1], *FRAME))


def context(crops: Sequence[Crop], brought: Mapping[str, Path] | None = None) -> Context:
    """What a provider of the tests is given."""
    return Context(brought or {}, crops, [crop.frame for crop in crops], "auto", 1)


def network(path: Path, shapes: Mapping[str, tuple], result: str, nodes: Sequence, output: tuple) -> Path:
    """Write a float network with inputs of ``shapes``, one output ``result`` of the shape ``output``, and ``nodes``."""
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()]
    outputs = [helper.make_tensor_value_info(result, TensorProto.FLOAT, output)]
    model = helper.make_model(
        helper.make_graph(list(nodes), "net", inputs, outputs),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString())
    return path


def constant(name: str, value: np.ndarray) -> onnx.NodeProto:
    """A node that gives ``value``."""
    return helper.make_node("Constant", [], [name], value=numpy_helper.from_array(np.asarray(value)))


def returning_body(folder: Path, side: int = 512) -> Path:
    """ICON's two files, but each gives half the body's normal where the picture is not zero, and NaN elsewhere."""
    for which in "FB":
        shapes = {"image": (1, 3, side, side), f"T_normal_{which}": (1, 3, side, side)}
        nodes = [
            helper.make_node("ReduceL1", ["image"], ["colour"], axes=[1], keepdims=1),
            constant("none", np.float32(0)),
            constant("half", np.float32(0.5)),
            constant("nan", np.float32(np.nan)),
            helper.make_node("Greater", ["colour", "none"], ["person"]),
            helper.make_node("Mul", [f"T_normal_{which}", "half"], ["short"]),
            helper.make_node("Where", ["person", "short", "nan"], [f"normal_{which}"]),
        ]
        network(folder / f"net{which}.onnx", shapes, f"normal_{which}", nodes, (1, 3, side, side))
    return folder
