"""People's boxes from a YOLOX network: with its raw head, or with the suppression of duplicates built in."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from soar.perception.brought import BroughtNetwork, fits
from soar.perception.ssd import box_iou

SIDE = 640  # of the input where the file leaves it free
STRIDES = (8, 16, 32)
GREY = 114
_BOX, _PERSON = 5, 5  # columns of a built-in result; column of the class of people in a raw one
_LARGEST = 20.0  # logarithm of a box's size in strides: beyond, the numbers are pixels


@dataclasses.dataclass(frozen=True)
class YoloxSettings:
    """Which boxes count.

    Attributes:
        min_score: in [0, 1].
        max_overlap: intersection over union from which two boxes are one person's.
    """

    min_score: float
    max_overlap: float


class Yolox:
    """One network; tells the two kinds of export apart by the last axis of the output, 5 or more.

    Args:
        path: the file.
        threads: threads of one inference.
        device: auto, cpu or cuda.
        settings: see there.

    Raises:
        ConfigError: there is no such device.
        ModelFileError: the file is missing, damaged, or no such network.
    """

    def __init__(self, path: Path, threads: int, device: str, settings: YoloxSettings) -> None:
        self._network, self._settings = BroughtNetwork(path, threads, device), settings
        self._input, self._output, self._size = layout(self._network)

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Boxes (N, 4) x0, y0, x1, y1 in pixels and scores (N,) of the people in an (H, W, 3) uint8 RGB frame."""
        height, width = self._size
        ratio = min(height / image.shape[0], width / image.shape[1])
        small = cv2.resize(image, (int(image.shape[1] * ratio), int(image.shape[0] * ratio)))
        canvas = np.full((height, width, 3), GREY, np.float32)
        canvas[: small.shape[0], : small.shape[1]] = small[..., ::-1]  # these networks see blue first
        found = self._network({self._input: canvas.transpose(2, 0, 1)[None]}, self._wanted)
        rows = found[self._output][0]
        boxes, scores = self._plain(rows, found) if rows.shape[1] == _BOX else self._decoded(rows)
        keep = scores >= self._settings.min_score
        boxes, scores = boxes[keep] / ratio, scores[keep]
        chosen = suppress(boxes, scores, self._settings.max_overlap)
        return boxes[chosen], scores[chosen]

    @property
    def _wanted(self) -> list[str]:
        return [self._output, *(name for name in ("labels",) if name in self._network.outputs)]

    @staticmethod
    def _plain(rows: np.ndarray, found: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Boxes and scores of rows (N, 5); classes other than people's are left out where there are labels."""
        people = found["labels"][0] == 0 if "labels" in found else np.ones(len(rows), bool)
        return rows[people, :4].astype(np.float64), rows[people, 4].astype(np.float64)

    def _decoded(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Boxes and scores of a raw head's rows (N, 5 + classes): place, size, objectness, classes."""
        grid = cells(*self._size)
        if len(rows) != len(grid) or rows.shape[1] <= _PERSON or rows[:, 2:4].max() > _LARGEST:
            raise self._network.misfit(
                f"{len(grid)} rows of a raw head, whose sizes are logarithms",
                f"{len(rows)} rows of {rows.shape[1]}, sizes up to {rows[:, 2:4].max():g}",
            )
        rows = rows.astype(np.float64)
        centre, half = (rows[:, :2] + grid[:, :2]) * grid[:, 2:], np.exp(rows[:, 2:4]) * grid[:, 2:] / 2
        return np.concatenate([centre - half, centre + half], 1), rows[:, 4] * rows[:, _PERSON]


def layout(network: BroughtNetwork) -> tuple[str, str, tuple[int, int]]:
    """Name of input and output, and the input's height and width.

    Raises:
        ModelFileError: the network is none of the two kinds.
    """
    outputs = [name for name, axes in network.outputs.items() if name != "labels" and fits((1, None, None), axes)]
    pictures = [name for name, axes in network.inputs.items() if fits((1, 3, None, None), axes)]
    columns = [network.outputs[name][-1] for name in outputs if network.outputs[name]]
    if len(network.inputs) != 1 or len(pictures) != 1 or len(outputs) != 1 or any(c and c < _BOX for c in columns):
        raise network.misfit("a picture (1, 3, H, W); gives boxes (1, N, 5) and labels, or a raw head (1, N, 85)")
    height, width = network.inputs[pictures[0]][2:] or (None, None)
    size = height or SIDE, width or SIDE
    if any(side % STRIDES[-1] for side in size):
        raise network.misfit(f"a height and width in multiples of {STRIDES[-1]}")
    return pictures[0], outputs[0], size


def cells(height: int, width: int) -> np.ndarray:
    """(N, 3) column, row and stride of the cells of a raw head: strides in order, row by row."""
    parts = []
    for stride in STRIDES:
        y, x = np.meshgrid(np.arange(height // stride), np.arange(width // stride), indexing="ij")
        parts.append(np.stack([x.ravel(), y.ravel(), np.full(x.size, stride)], 1))
    return np.concatenate(parts).astype(np.float64)


def suppress(boxes: np.ndarray, scores: np.ndarray, max_overlap: float) -> list[int]:
    """Indices of the boxes (N, 4) that no better one overlaps by more than ``max_overlap``, best first."""
    left, kept = np.argsort(-scores, kind="stable"), []
    while len(left):
        kept.append(int(left[0]))
        left = left[1:][box_iou(boxes[left[0]], boxes[left[1:]]) <= max_overlap]
    return kept
