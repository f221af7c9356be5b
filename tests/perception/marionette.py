"""A person of coloured dots, networks that know the colours, and a stand-in for BlazePose that knows the person.

Every keypoint of COCO-WholeBody is a dot of its own colour; a network finds each by its colour, so what comes out of a
crop can be compared with where the dots were drawn.
"""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from soar.body.openpose import BODY, INDEX
from soar.perception.lift import body_region, landmarks
from soar.perception.pose import Pose
from soar.perception.roi import Roi
from soar.perception.simcc import DEVIATION, MEAN
from soar.perception.wholebody import BODY_AND_FEET, WHOLEBODY, openpose_137
from soar.workflow.configuration import composed
from tests.perception.exports import export

WIDTH, HEIGHT = 640, 480
BOX = np.array([110.0, 30.0, 540.0, 450.0])
RADIUS = 6
COLOURS = np.array([c for c in itertools.product((0, 51, 102, 153, 204, 255), repeat=3) if np.ptp(c) > 60])
COLOURS = COLOURS[np.linspace(0, len(COLOURS) - 1, WHOLEBODY).round().astype(int)]
_PLACES = {  # right, down from the middle of the hips; of the left side
    "nose": (0, -170), "eye": (12, -186), "ear": (26, -180), "shoulder": (50, -120), "elbow": (66, -60),
    "wrist": (80, 0), "hip": (34, 0), "knee": (36, 80), "ankle": (38, 160), "heel": (28, 176), "big_toe": (46, 184),
    "small_toe": (62, 178),
}  # fmt: skip


def truth(t: int, middle: tuple[float, float] = (250.0, 240.0)) -> np.ndarray:
    """(133, 3) keypoints of frame ``t`` in whole pixels, the first pixel's centre at 0.5; confidence 1."""
    points = np.ones((WHOLEBODY, 3))
    for i, name in enumerate(BODY_AND_FEET):
        side = 1 if name.startswith("left") else -1
        x, y = _PLACES[name.removeprefix("left_").removeprefix("right_")]
        points[i, :2] = side * x, y
    # Hands and face are beside the body, so that no dots meet.
    for first, count, x in ((23, 68, 120), (91, 42, 230)):
        k = np.arange(count)
        points[first : first + count, :2] = np.stack([x + 14 * (k % 7), -180 + 16 * (k // 7)], 1)
    points[:, :2] += np.array(middle) + (2 * t, 0) + 0.5
    return points


def frame(t: int, dots: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 RGB: the dots (133, 3) before grey; the number of the frame as a shade at the bottom."""
    image = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    for (x, y, _), colour in zip(dots, COLOURS.tolist(), strict=True):
        cv2.circle(image, (round(x - 0.5), round(y - 0.5)), RADIUS, colour, -1)
    image[-40:, WIDTH // 2 - 40 : WIDTH // 2 + 40] = 20 * t
    return image


def number(image: np.ndarray) -> int:
    """The number a frame was made with."""
    height, width = image.shape[:2]
    return round(float(image[-height // 30 : -height // 60, width // 2 - 4 : width // 2 + 4].mean()) / 20)


class DotFinder(nn.Module):
    """SimCC head of known answer: how much of each column and row has the keypoint's colour, at half pixels."""

    def __init__(self, keypoints: int = WHOLEBODY, gain: float = 1.0) -> None:
        super().__init__()
        self.colours = nn.Parameter(torch.tensor((COLOURS[:keypoints] - MEAN) / DEVIATION, dtype=torch.float32))
        self.gain = gain

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        c = self.colours[:, :, None, None]
        far = (x**2).sum(1, keepdim=True) - 2 * F.conv2d(x, c) + (self.colours**2).sum(1)[:, None, None]
        same = (1 - 20 * far).clamp(min=0)
        columns, rows = (self.gain * _smooth(_smooth(same.sum(axis))) / 3 for axis in (2, 3))
        return columns.repeat_interleave(2, -1), rows.repeat_interleave(2, -1)


def _smooth(profile: Tensor) -> Tensor:
    """With a peak in the middle of each dot."""
    return F.avg_pool1d(profile, 7, 1, 3)


def dot_finder(path: Path, size: tuple[int, int] = (384, 288), free: bool = True, **options: Any) -> Path:
    """Write a :class:`DotFinder` for crops of ``size`` (H, W), for any number of them or one."""
    axes = {name: {0: "batch"} for name in ("input", "simcc_x", "simcc_y")} if free else {}
    return export(DotFinder(**options), path, {"input": torch.zeros(1, 3, *size)}, ["simcc_x", "simcc_y"], **axes)


class Boxes(nn.Module):
    """A detector that always finds the same people, with duplicates suppressed."""

    def __init__(self, boxes: np.ndarray, labels: list[int]) -> None:
        super().__init__()
        self.boxes, self.labels = torch.tensor(boxes, dtype=torch.float32), torch.tensor(labels)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        return self.boxes[None] + 0 * x.sum(), self.labels[None] + 0 * x.sum().long()


def detector(path: Path, rows: list[tuple[float, ...]], labels: list[int] | None = None) -> Path:
    """Write a YOLOX export that gives ``dets`` and ``labels``: rows x0, y0, x1, y1, score in its 640 x 640 pixels."""
    module = Boxes(np.array(rows), labels or [0] * len(rows))
    return export(module, path, {"input": torch.zeros(1, 3, 640, 640)}, ["dets", "labels"])


@dataclasses.dataclass
class KnownPose:
    """Takes the place of the pose network: knows the person of every frame, whose left is nearer to the camera."""

    people: np.ndarray
    absent: tuple[int, ...] = ()
    asked: list[int] = dataclasses.field(default_factory=list)

    def __call__(self, image: np.ndarray, roi: Roi, mirrored: bool = False) -> Pose:
        t = number(image)
        self.asked.append(t)
        body = openpose_137(self.people[t])[: len(BODY)]
        points = landmarks(body[:, :2])
        side = landmarks(np.array([name.startswith("right") - name.startswith("left") for name in BODY])[:, None])[:, 0]
        world = np.column_stack([(points - body[INDEX["mid_hip"], :2]) / 300, 0.2 * side])
        presence = 0.1 if t in self.absent else 0.95
        region = body_region(body)
        assert region is not None
        return Pose(roi, presence, points, np.full(33, 0.9), world, region, np.zeros((4, 4), np.float32))


def node(option: str, **changes: Any) -> dict[str, Any]:
    """The node ``keypoints`` of an option, with changes."""
    return composed((f"keypoints={option}",))["keypoints"] | changes
