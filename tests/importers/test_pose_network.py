"""The network by contract: what it is fed, whose camera its answer is in, and networks that break the contract."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from soar.body.observations import Observations
from soar.body.openpose import BODY, COUNT
from soar.body.parameters import HandSpace, in_world
from soar.errors import ModelFileError, SubjectError
from soar.importers.pose_network import Box, PoseNetwork
from tests.importers import person

SIZES = {
    "root_pose": 3, "body_pose": 63, "left_hand_pose": 45, "right_hand_pose": 45, "jaw_pose": 3, "betas": 10,
    "expression": 10, "cam_trans": 3,
}  # fmt: skip
MODEL = person.body()


def write_network(
    path: Path, bias: dict[str, np.ndarray] | None = None, gain: float = 0.0, batch: int | str = 1, **renamed: str
) -> Path:
    """Names and shapes of the contract: the mean colour times a random matrix times ``gain``, plus ``bias``."""
    total = sum(SIZES.values())
    rng = np.random.default_rng(0)
    offset = np.concatenate([np.zeros(n) if bias is None else bias.get(k, np.zeros(n)) for k, n in SIZES.items()])
    constants = {
        "W": (gain * rng.standard_normal((3, total))).astype(np.float32), "b": offset.astype(np.float32),
        "sizes": np.array(list(SIZES.values())), "flat": np.array([-1, 3]),
    }  # fmt: skip
    names = [renamed.get(name, name) for name in SIZES]
    nodes = [
        helper.make_node("GlobalAveragePool", ["image"], ["mean"]),
        helper.make_node("Reshape", ["mean", "flat"], ["colour"]),
        helper.make_node("Gemm", ["colour", "W", "b"], ["all"]),
        helper.make_node("Split", ["all", "sizes"], names, axis=1),
    ]
    outputs = zip(names, SIZES.values(), strict=True)
    graph = helper.make_graph(
        nodes, "regressor", [helper.make_tensor_value_info("image", TensorProto.FLOAT, [batch, 3, 512, 384])],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, size]) for name, size in outputs],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )  # fmt: skip
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def seen_at(boxes: np.ndarray) -> Observations:
    """A camera of 640 x 480 in which the body keypoints lie along the diagonals of boxes (T, 4) x0, y0, x1, y1."""
    points = np.zeros((len(boxes), COUNT, 3))
    share = np.linspace(0, 1, len(BODY))[:, None]
    points[:, : len(BODY), :2] = boxes[:, None, :2] * (1 - share) + boxes[:, None, 2:] * share
    points[:, : len(BODY), 2] = 1
    return Observations.gather([person.camera()], [points], [np.zeros((len(boxes), 25, 3))], 0.3)


def test_the_box_has_the_network_s_shape_and_the_camera_looks_at_its_middle() -> None:
    tall = Box.around(np.array([[100.0, 50], [140, 450]]), (640, 480), 1.25)
    assert (tall.width, tall.height) == pytest.approx((375, 500))
    assert (tall.x + tall.width / 2, tall.y + tall.height / 2) == pytest.approx((120, 250))
    wide = Box.around(np.array([[-100.0, 200], [300, 260]]), (640, 480), 1.0)
    assert (wide.x, wide.width, wide.height) == pytest.approx((0, 300, 400))
    K = wide.intrinsics()
    np.testing.assert_allclose(K, [[5000 * 300 / 192, 0, 150], [0, 5000 * 400 / 256, 230], [0, 0, 1]])
    assert K[0, 0] == pytest.approx(K[1, 1])


def test_the_picture_is_the_box_in_rgb() -> None:
    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(0, 255, (12, 16, 3)), np.ones((40, 40, 1))).astype(np.uint8)
    picture = Box(120, 40, 240, 320).picture(image)
    assert (picture.shape, picture.dtype) == ((1, 3, 512, 384), np.float32)
    for x, y in ((140, 60), (300, 340)):  # middles of blocks
        at = picture[0, :, round((y - 40) * 512 / 320), round((x - 120) * 384 / 240)]
        np.testing.assert_allclose(at, image[y, x] / 255, atol=1e-6)
    assert not Box(-400, 0, 150, 200).picture(image).any()


@pytest.mark.parametrize("batch", [1, "N"])
def test_estimates_are_in_the_camera_of_each_box(tmp_path: Path, batch: int | str) -> None:
    """A network that always sees the body 50 m away in the middle: the pelvis is where the box is."""
    space = HandSpace.of(MODEL)
    middle = np.array([0.0, 0.0, 50.0]) - MODEL.J_template[0].numpy()
    bias = {
        "root_pose": np.array([np.pi, 0, 0]),
        "cam_trans": middle,
        "betas": np.zeros(10),
        "jaw_pose": np.full(3, 0.1),
    }
    network = PoseNetwork(write_network(tmp_path / "n.onnx", bias, batch=batch), "cpu", 1)
    boxes = np.array([[100.0, 50, 200, 350], [0, 0, 0, 0], [300, 100, 400, 400]])
    seen = seen_at(boxes)
    seen.confidence[0, 1] = 0
    frames = np.zeros((3, 480, 640, 3), np.uint8)
    archive = network(frames, [10, 12, 14], seen, space, 1.25)
    (found,) = archive.people
    assert (found.frames.tolist(), archive.first) == ([10, 14], 0)
    np.testing.assert_allclose(found.left_hand[0].ravel(), space.mean[0], atol=1e-6)
    np.testing.assert_allclose(found.face[0, 0], 0.1, atol=1e-6)
    world = in_world(found, MODEL, person.camera())
    pixels = person.camera().project(world.pelvis(MODEL))
    np.testing.assert_allclose(pixels, [[150, 200], [350, 250]], atol=0.01)
    # 300 pixels tall boxes, 1.25 times, of a camera of 5000 pixels for 256: seen by ours with 900 pixels.
    assert world.pelvis(MODEL)[0, 2] == pytest.approx(50 * 900 / (5000 * 375 / 256), rel=1e-5)


def test_the_answer_depends_on_the_picture(tmp_path: Path) -> None:
    network = PoseNetwork(write_network(tmp_path / "n.onnx", gain=0.3), "cpu", 1)
    frames = np.stack([np.full((480, 640, 3), colour, np.uint8) for colour in ((200, 0, 0), (0, 0, 200))])
    (found,) = network(frames, [0, 1], seen_at(np.tile([200.0, 100, 300, 400], (2, 1))), None, 1.25).people
    weights = (0.3 * np.random.default_rng(0).standard_normal((3, sum(SIZES.values())))).astype(np.float32)
    np.testing.assert_allclose(found.global_orient[0], weights[0, :3] * 200 / 255, rtol=2e-3)
    np.testing.assert_allclose(found.global_orient[1], weights[2, :3] * 200 / 255, rtol=2e-3)
    assert found.left_hand is None


def test_networks_that_break_the_contract(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="other outputs"):
        PoseNetwork(write_network(tmp_path / "a.onnx", cam_trans="camera"), "cpu", 1)
    (tmp_path / "b.onnx").write_bytes((tmp_path / "a.onnx").read_bytes()[:1000])
    with pytest.raises(ModelFileError):
        PoseNetwork(tmp_path / "b.onnx", "cpu", 1)
    seen = seen_at(np.array([[200.0, 100, 300, 400]]))
    frames = np.zeros((1, 480, 640, 3), np.uint8)
    bad = PoseNetwork(write_network(tmp_path / "c.onnx", {"betas": np.full(10, np.nan)}), "cpu", 1)
    with pytest.raises(ModelFileError, match="betas is unusable"):
        bad(frames, [0], seen, None, 1.25)
    seen.confidence[:] = 0
    with pytest.raises(SubjectError, match="never sees"):
        bad(frames, [0], seen, None, 1.25)
