"""Person detector (BlazePose): finds people by face box, hips and shoulders, and gives the region of their pose."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import cv2
import numpy as np

from soar.perception import ssd
from soar.perception.networks import Network
from soar.perception.roi import Roi, align, letterbox

POSE_SCALE = 1.25  # of the circle around the whole body, as the landmark network was trained
NMS_IOU = 0.3
ANCHORS = 2254


@dataclasses.dataclass(frozen=True)
class Person:
    """A person found in a frame: detector score in [0, 1] and the square region around the whole body."""

    score: float
    roi: Roi


def pose_roi(centre: np.ndarray, rim: np.ndarray) -> Roi:
    """Region of a body from its mid-hip point and a point on the circle around it, straight above when upright."""
    return align(centre, rim, target=math.pi / 2, scale=POSE_SCALE)


class PersonDetector:
    """``pose_detection.onnx`` on whole frames.

    Args:
        path: the network file.
        threads: threads of one inference.
        min_score: detections below are dropped, in [0, 1].
    """

    def __init__(self, path: Path, threads: int, min_score: float) -> None:
        outputs = {"Identity": (1, ANCHORS, 12), "Identity_1": (1, ANCHORS, 1)}
        self._network = Network(path, outputs, (-1.0, 1.0), threads)
        self._min_score = min_score

    def __call__(self, image: np.ndarray) -> list[Person]:
        """All people in an (H, W, 3) uint8 RGB frame, best score first."""
        window = letterbox(image.shape[1], image.shape[0])
        raw, logits = self._network(window.crop(image, self._network.size, border=cv2.BORDER_CONSTANT))
        found = ssd.weighted_nms(ssd.decode(raw, logits[:, 0], ssd.POSE_ANCHORS, self._min_score), NMS_IOU)
        people = (Person(d.score, pose_roi(*window.to_image(d.keypoints[:2], 1.0))) for d in found)
        return [p for p in people if p.roi.usable]
