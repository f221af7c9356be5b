"""Face landmarks: a face detector inside the head region of the pose, then a mesh of 468 points."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from soar.perception import ssd
from soar.perception.networks import Network
from soar.perception.pose import INDEX, Pose
from soar.perception.roi import Roi, around

HEAD_POINTS = 11  # the first landmarks of the pose, nose to mouth
MIN_DETECTION = 0.5
MIN_PRESENCE = 0.5
NMS_IOU = 0.3
ANCHORS = 896


@dataclasses.dataclass(frozen=True)
class Face:
    """Face mesh: (468, 2) image pixels and the network's confidence in [0, 1]."""

    points: np.ndarray
    presence: float


def head_roi(pose: Pose) -> Roi:
    """Upright-face region around the head points of the pose."""
    eyes = pose.points[INDEX["right_eye"]], pose.points[INDEX["left_eye"]]
    return around(pose.points[:HEAD_POINTS], *eyes, target=0.0, scale=3.0, shift_y=0.0)


class FaceNetwork:
    """``face_detection_short_range.onnx`` and ``face_landmark.onnx``.

    Args:
        folder: where both files are.
        threads: threads of one inference.
    """

    def __init__(self, folder: Path, threads: int) -> None:
        outputs = {"regressors": (1, ANCHORS, 16), "classificators": (1, ANCHORS, 1)}
        self._detector = Network(folder / "face_detection_short_range.onnx", outputs, (-1.0, 1.0), threads)
        mesh = {"conv2d_21": (1, 1, 1, 1404), "conv2d_31": (1, 1, 1, 1)}
        self._mesh = Network(folder / "face_landmark.onnx", mesh, (0.0, 1.0), threads)

    def __call__(self, image: np.ndarray, pose: Pose) -> Face | None:
        """The face of a pose, or None when none is seen (turned away, hidden, pixelated)."""
        head = head_roi(pose)
        if not head.usable:
            return None
        raw, logits = self._detector(head.crop(image, self._detector.size, border=cv2.BORDER_CONSTANT))
        found = ssd.weighted_nms(ssd.decode(raw, logits[:, 0], ssd.FACE_ANCHORS, MIN_DETECTION), NMS_IOU)
        if not found:
            return None
        keypoints = head.to_image(found[0].keypoints, 1.0)
        roi = around(keypoints, keypoints[0], keypoints[1], target=0.0, scale=2.0, shift_y=-0.1)
        if not roi.usable:
            return None
        raw, logit = self._mesh(roi.crop(image, self._mesh.size, border=cv2.BORDER_REPLICATE))
        presence = float(ssd.sigmoid(logit).item())
        if presence < MIN_PRESENCE:
            return None
        return Face(roi.to_image(raw.reshape(468, 3)[:, :2], self._mesh.size), presence)
