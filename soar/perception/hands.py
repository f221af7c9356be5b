"""Hand landmarks: the region of each hand from the wrist and fingers of the pose, corrected once, then 21 points."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from soar.perception.networks import Network
from soar.perception.pose import INDEX, Pose
from soar.perception.roi import Roi, align

MIN_WRIST_VISIBILITY = 0.1
MIN_PRESENCE = 0.5


def hand_roi(wrist: np.ndarray, index: np.ndarray, pinky: np.ndarray) -> Roi:
    """First guess of a hand's region from three image points (2,) of the pose: fingers up, palm in the middle."""
    knuckles = (2 * index + pinky) / 3
    along = knuckles - wrist
    # The region turns with wrist -> knuckles but is centred at the knuckles, so align() starts from there.
    return align(knuckles, knuckles + along, target=math.pi / 2, scale=2.7, shift_y=-0.1)


class HandNetwork:
    """``hand_recrop.onnx`` and ``hand_landmark_full.onnx``.

    Args:
        folder: where both files are.
        threads: threads of one inference.
    """

    def __init__(self, folder: Path, threads: int) -> None:
        self._recrop = Network(folder / "hand_recrop.onnx", {"output_crop": (1, 1, 1, 4)}, (0.0, 1.0), threads)
        outputs = {"Identity": (1, 63), "Identity_1": (1, 1)}
        self._landmarks = Network(folder / "hand_landmark_full.onnx", outputs, (0.0, 1.0), threads)

    def __call__(self, image: np.ndarray, pose: Pose, side: Literal["left", "right"]) -> np.ndarray:
        """(21, 3) image x, y and confidence of one hand, wrist first, thumb to little finger; zeros if not found."""
        wrist, index, pinky = (INDEX[f"{side}_{part}"] for part in ("wrist", "index", "pinky"))
        nothing = np.zeros((21, 3))
        if pose.visibility[wrist] < MIN_WRIST_VISIBILITY:
            return nothing
        guess = hand_roi(*pose.points[[wrist, index, pinky]])
        if not guess.usable:
            return nothing
        (corners,) = self._recrop(guess.crop(image, self._recrop.size, border=cv2.BORDER_REPLICATE))
        centre, rim = guess.to_image(corners.reshape(2, 2), self._recrop.size)
        roi = align(centre, rim, target=-math.pi / 2, scale=1.0, shift_y=-0.1)
        if not roi.usable:
            return nothing
        raw, presence = self._landmarks(roi.crop(image, self._landmarks.size, border=cv2.BORDER_REPLICATE))
        if presence[0] < MIN_PRESENCE:
            return nothing
        points = roi.to_image(raw.reshape(21, 3)[:, :2], self._landmarks.size)
        return np.column_stack([points, np.full(21, presence[0])])
