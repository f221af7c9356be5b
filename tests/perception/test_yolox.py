"""People's boxes from both kinds of YOLOX export, with boxes that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from soar.errors import ModelFileError
from soar.perception.yolox import Yolox, YoloxSettings, cells, suppress
from tests.perception.exports import export
from tests.perception.marionette import detector, dot_finder

SETTINGS = YoloxSettings(0.3, 0.45)
SIZE = np.log(5.0)  # of a box, in logarithms of strides


class RawHead(nn.Module):
    """A raw head that sees a person about the middle of every cell of 32 pixels that is blue all over.

    Shifted by a quarter of a cell to the right; twice as high as wide. The class of people scores 0.9, another 1.
    """

    def __init__(self, plain: bool = False) -> None:
        super().__init__()
        self.plain = plain

    def forward(self, x: Tensor) -> Tensor:
        rows = []
        for stride in (8, 16, 32):
            blue = (F.avg_pool2d(x[:, :1], stride) / 255 * 2 - 1).clamp(min=0).flatten(1)[..., None]
            none, one = torch.zeros_like(blue), torch.ones_like(blue)
            seen = blue if stride == 32 else none
            size = 40 if self.plain else SIZE
            rows.append(torch.cat(
                [0.75 * one, 0.5 * one, size * one, (size + np.log(2.0)) * one, seen, 0.9 * one, one], -1))  # fmt: skip
        return torch.cat(rows, 1)


def _raw(path: Path, plain: bool = False, size: int = 640) -> Yolox:
    export(RawHead(plain), path, {"images": torch.zeros(1, 3, size, size)}, ["output"])
    return Yolox(path, 1, "cpu", SETTINGS)


def _picture(blue: tuple[int, ...] = (0, 0, 255)) -> np.ndarray:
    """320 x 240 pixels, black but for the square of one cell of a detector that enlarges it twice."""
    image = np.zeros((240, 320, 3), np.uint8)
    image[48:64, 96:112] = blue
    return image


def test_raw_head(tmp_path: Path) -> None:
    boxes, scores = _raw(tmp_path / "raw.onnx")(_picture())
    # Cell (6, 3) of stride 32: centre (6.75, 3.5) strides, 5 x 10 strides large; the picture was enlarged twice.
    x, y = 6.75 * 16, 3.5 * 16
    np.testing.assert_allclose(boxes, [[x - 40, y - 80, x + 40, y + 80]], rtol=1e-5)
    assert 0.8 < scores[0] < 0.9  # objectness times the class; the square's edge is soft


def test_a_raw_head_is_shown_blue_first_and_grey_beyond_the_picture(tmp_path: Path) -> None:
    network = _raw(tmp_path / "raw.onnx")
    assert len(network(_picture((255, 0, 0)))[0]) == 0
    assert len(network(np.zeros((240, 320, 3), np.uint8))[0]) == 0  # 114 is less than half


def test_neighbouring_cells_are_one_person(tmp_path: Path) -> None:
    image = _picture()
    image[48:64, 112:128] = (0, 0, 230)  # a little less blue
    boxes, _ = _raw(tmp_path / "raw.onnx")(image)
    assert len(boxes) == 1
    np.testing.assert_allclose(boxes[0, 0], 6.75 * 16 - 40, rtol=1e-5)  # the better one's box
    image[192:208, 240:256] = (0, 0, 255)
    assert len(_raw(tmp_path / "raw.onnx")(image)[0]) == 2


def test_suppression_built_in(tmp_path: Path) -> None:
    rows = [(100, 40, 300, 440, 0.8), (400, 60, 500, 300, 0.6), (10, 10, 50, 60, 0.2)]
    network = Yolox(detector(tmp_path / "nms.onnx", rows), 1, "cpu", SETTINGS)
    boxes, scores = network(_picture())
    np.testing.assert_allclose(boxes, [[50, 20, 150, 220], [200, 30, 250, 150]])
    np.testing.assert_allclose(scores, [0.8, 0.6], rtol=1e-6)


def test_labels_of_other_things_are_left_out(tmp_path: Path) -> None:
    rows = [(100, 40, 300, 440, 0.8), (400, 60, 500, 300, 0.6)]
    network = Yolox(detector(tmp_path / "nms.onnx", rows, labels=[2, 0]), 1, "cpu", SETTINGS)
    np.testing.assert_allclose(network(_picture())[1], [0.6], rtol=1e-6)


def test_boxes_in_pixels_from_a_head_that_decodes_itself_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="sizes up to 40") as error:
        _raw(tmp_path / "raw.onnx", plain=True)(_picture())
    assert "8400 rows" in error.value.expected


def test_another_size_of_input(tmp_path: Path) -> None:
    boxes, _ = _raw(tmp_path / "raw.onnx", size=320)(_picture())
    assert len(boxes) == 0  # the square is half a cell
    image = np.zeros((240, 320, 3), np.uint8)
    image[32:64, 64:96] = (0, 0, 255)
    boxes, _ = _raw(tmp_path / "raw.onnx", size=320)(image)
    np.testing.assert_allclose(boxes[:, :2], [[(2.75 - 2.5) * 32, (1.5 - 5) * 32]], rtol=1e-4)


def test_what_is_no_detector_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="not the network") as error:
        Yolox(dot_finder(tmp_path / "simcc.onnx", (64, 64)), 1, "cpu", SETTINGS)
    assert "simcc_x" in error.value.got
    with pytest.raises(ModelFileError, match="not the network"):
        export(nn.Identity(), tmp_path / "odd.onnx", {"x": torch.zeros(1, 3, 600, 650)}, ["y"])
        Yolox(tmp_path / "odd.onnx", 1, "cpu", SETTINGS)
    (tmp_path / "broken.onnx").write_bytes((tmp_path / "odd.onnx").read_bytes()[:40])
    with pytest.raises(ModelFileError):
        Yolox(tmp_path / "broken.onnx", 1, "cpu", SETTINGS)


def test_cells_and_suppression() -> None:
    grid = cells(64, 96)
    assert len(grid) == 8 * 12 + 4 * 6 + 2 * 3
    assert grid[13].tolist() == [1, 1, 8]
    assert grid[-1].tolist() == [2, 1, 32]
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [20, 0, 30, 10.0]])
    assert suppress(boxes, np.array([0.5, 0.9, 0.4]), 0.45) == [1, 2]
    assert suppress(boxes[:0], np.zeros(0), 0.45) == []
