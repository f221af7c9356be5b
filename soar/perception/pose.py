"""Body landmarks (BlazePose): 33 image points, 33 metric points and a person mask from one rotated crop."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from soar.perception.detector import pose_roi
from soar.perception.networks import Network
from soar.perception.roi import Roi
from soar.perception.ssd import sigmoid

LANDMARKS = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
INDEX = {name: i for i, name in enumerate(LANDMARKS)}


def _opposite(name: str) -> str:
    return name.replace("left", "\0").replace("right", "left").replace("\0", "right")


MIRROR = np.array([INDEX[_opposite(name)] for name in LANDMARKS])  # index of each landmark's twin on the other side

HEATMAP_RADIUS = 4  # 9 x 9 cells: what the reference implementation does, although its graph file says 7 x 7
HEATMAP_MIN_PEAK = 0.5
CENTRE, RIM = 33, 34  # auxiliary landmarks from which the next frame's region follows


@dataclasses.dataclass(frozen=True)
class Pose:
    """One pass of the landmark network.

    Attributes:
        roi: the region it ran on.
        presence: probability in [0, 1] that the region shows a person.
        points: (33, 2) image pixels.
        visibility: (33,) in [0, 1].
        world: (33, 3) metres, origin between the hips, image-upright axes: x right, y down, z away from the camera.
        next_roi: where to look in a neighbouring frame.
        mask: (S, S) person probability over the crop, float32; of the mirrored crop if the pass was mirrored.
    """

    roi: Roi
    presence: float
    points: np.ndarray
    visibility: np.ndarray
    world: np.ndarray
    next_roi: Roi
    mask: np.ndarray


def refine(points: np.ndarray, heatmap: np.ndarray) -> np.ndarray:
    """Move landmarks to the weighted mean of their heatmap around them.

    Args:
        points: (L, 2) in units of the crop, [0, 1] inside.
        heatmap: (h, w, L) logits.

    Returns:
        (L, 2); a landmark stays as it was where the heatmap nowhere reaches one half, or when it is outside the crop.
    """
    height, width = heatmap.shape[:2]
    refined = points.copy()
    cells = np.floor(points * (width, height)).astype(int)
    for i, (cx, cy) in enumerate(cells):
        if not (0 <= cx < width and 0 <= cy < height):
            continue
        x0, y0 = max(0, cx - HEATMAP_RADIUS), max(0, cy - HEATMAP_RADIUS)
        weights = sigmoid(heatmap[y0 : cy + HEATMAP_RADIUS + 1, x0 : cx + HEATMAP_RADIUS + 1, i])
        if weights.max() < HEATMAP_MIN_PEAK:
            continue
        x = weights.sum(0) @ np.arange(x0, x0 + weights.shape[1])
        y = weights.sum(1) @ np.arange(y0, y0 + weights.shape[0])
        refined[i] = np.array([x / width, y / height]) / weights.sum()
    return refined


class PoseNetwork:
    """``pose_landmark_{full,heavy}.onnx``.

    Args:
        path: the network file.
        threads: threads of one inference.
    """

    def __init__(self, path: Path, threads: int) -> None:
        outputs = {
            "Identity": (1, 195), "Identity_1": (1, 1), "Identity_2": (1, 256, 256, 1),
            "Identity_3": (1, 64, 64, 39), "Identity_4": (1, 117),
        }  # fmt: skip
        self._network = Network(path, outputs, (0.0, 1.0), threads)

    def __call__(self, image: np.ndarray, roi: Roi, mirrored: bool = False) -> Pose:
        """Estimate the pose in ``roi`` of an (H, W, 3) uint8 RGB frame.

        With ``mirrored`` the network sees the flipped crop; points and sides are mapped back, so both passes are
        directly comparable.
        """
        size = self._network.size
        raw, presence, mask, heatmap, world = self._network(
            roi.crop(image, size, border=cv2.BORDER_REPLICATE, mirrored=mirrored)
        )
        raw = raw.reshape(39, 5).astype(np.float64)
        points = roi.to_image(refine(raw[:, :2] / size, heatmap), 1.0, mirrored)
        visibility = sigmoid(raw[:33, 3])
        world = world.reshape(39, 3)[:33].astype(np.float64)
        if mirrored:
            world = world * (-1, 1, 1)
        world[:, :2] = world[:, :2] @ roi.axes().T
        order = MIRROR if mirrored else slice(None)
        return Pose(
            roi=roi,
            presence=float(presence[0]),
            points=points[:33][order],
            visibility=visibility[order],
            world=world[order],
            next_roi=pose_roi(points[CENTRE], points[RIM]),
            mask=sigmoid(mask[..., 0]).astype(np.float32),
        )
