"""Soft person masks: averaged over four crops, refined along image edges, reduced to what touches the skeleton."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np

from soar.body.openpose import INDEX
from soar.perception.pose import PoseNetwork
from soar.perception.roi import Roi

# Limbs whose pixels certainly belong to the person, as pairs of BODY_25 names.
BONES = (
    ("nose", "neck"), ("neck", "mid_hip"), ("neck", "left_shoulder"), ("neck", "right_shoulder"),
    ("left_shoulder", "left_elbow"), ("left_elbow", "left_wrist"),
    ("right_shoulder", "right_elbow"), ("right_elbow", "right_wrist"),
    ("mid_hip", "left_hip"), ("mid_hip", "right_hip"), ("left_hip", "left_knee"), ("left_knee", "left_ankle"),
    ("right_hip", "right_knee"), ("right_knee", "right_ankle"), ("left_ankle", "left_heel"),
    ("left_ankle", "left_big_toe"), ("right_ankle", "right_heel"), ("right_ankle", "right_big_toe"),
)  # fmt: skip
BONE_INDEX = np.array([[INDEX[a], INDEX[b]] for a, b in BONES])


@dataclasses.dataclass(frozen=True)
class View:
    """One crop of the average: ``scale`` and ``rotation`` (radians) relative to the tracked region."""

    scale: float
    rotation: float
    mirrored: bool


@dataclasses.dataclass(frozen=True)
class MaskSettings:
    """Settings of :class:`MediaPipeMasks`; see ``conf/masks/mediapipe.yaml``."""

    provider: Literal["mediapipe"]
    model: Literal["full", "heavy"]
    views: tuple[View, ...]
    margin: float
    guide_radius: float
    guide_eps: float
    contrast: float
    min_keypoint_confidence: float
    bone_width: float
    fringe: float


class MaskProvider(Protocol):
    """An estimator of a soft person mask."""

    def __call__(self, image: np.ndarray, roi: Roi, body: np.ndarray) -> np.ndarray:
        """Estimate the mask of the person that ``roi`` and ``body`` describe.

        Args:
            image: (H, W, 3) uint8 RGB frame.
            roi: the tracked region of the person.
            body: (25, 3) BODY_25 keypoints, x, y in pixels and confidence.

        Returns:
            (H, W) float32 alpha in [0, 1]; all zero when nothing was found.
        """


def window(roi: Roi, margin: float, width: int, height: int) -> tuple[int, int, int, int]:
    """Upright pixel window x0, y0, x1, y1 around ``roi`` grown ``margin`` times, cut to the image; may be empty."""
    half = roi.side * margin * (abs(np.cos(roi.rotation)) + abs(np.sin(roi.rotation))) / 2
    x0, x1 = (int(np.clip(v, 0, width)) for v in (np.floor(roi.cx - half), np.ceil(roi.cx + half)))
    y0, y1 = (int(np.clip(v, 0, height)) for v in (np.floor(roi.cy - half), np.ceil(roi.cy + half)))
    return x0, y0, x1, y1


def paste(mask: np.ndarray, roi: Roi, mirrored: bool, rect: tuple[int, int, int, int]) -> np.ndarray:
    """Resample a crop's mask (S, S) into the pixel window ``rect`` of the image; zero outside the crop."""
    x0, y0, x1, y1 = rect
    matrix = roi.image_from_crop(mask.shape[0], mirrored) - [[0, 0, x0], [0, 0, y0]]
    return cv2.warpAffine(mask, matrix, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def support(mask: np.ndarray, grow: int) -> tuple[slice, slice]:
    """Rows and columns of the bounding box of ``mask`` (H, W) >= 1/255, grown by ``grow`` pixels; empty for none."""
    x, y, width, height = cv2.boundingRect((mask >= 1 / 255).astype(np.uint8))
    if not width:
        return slice(0, 0), slice(0, 0)
    return slice(max(0, y - grow), y + height + grow), slice(max(0, x - grow), x + width + grow)


def skeleton(body: np.ndarray, shape: tuple[int, int], min_confidence: float, width: int) -> np.ndarray:
    """(H, W) uint8 image, 1 on the bones both ends of which reach ``min_confidence``, drawn ``width`` pixels wide."""
    canvas = np.zeros(shape, np.uint8)
    for a, b in BONE_INDEX:
        if min(body[a, 2], body[b, 2]) >= min_confidence:
            ends = [tuple(round(float(v)) for v in body[i, :2]) for i in (a, b)]
            cv2.line(canvas, ends[0], ends[1], 1, max(1, width))
    return canvas


def keep_touching(alpha: np.ndarray, touch: np.ndarray, fringe: int) -> np.ndarray:
    """Remove components of ``alpha`` > 1/2 that ``touch`` (H, W) does not reach, and soft pixels far from the others.

    Args:
        alpha: (H, W) float in [0, 1].
        touch: (H, W), non-zero on pixels of the person.
        fringe: width of the soft edge that is kept around a component, pixels.
    """
    _, labels = cv2.connectedComponents((alpha > 0.5).astype(np.uint8), connectivity=8)
    wanted = np.unique(labels[touch > 0])
    kept = np.isin(labels, wanted[wanted > 0]).astype(np.uint8)
    size = 2 * max(1, fringe) + 1
    return alpha * cv2.dilate(kept, np.ones((size, size), np.uint8))


class MediaPipeMasks:
    """Masks from the segmentation head of the BlazePose landmark network; implements :class:`MaskProvider`.

    Args:
        settings: see the conf file.
        models: folder of the ``.onnx`` files.
        threads: threads of one inference.
    """

    def __init__(self, settings: MaskSettings, models: Path, threads: int) -> None:
        self._settings = settings
        self._pose = PoseNetwork(models / f"pose_landmark_{settings.model}.onnx", threads)

    def __call__(self, image: np.ndarray, roi: Roi, body: np.ndarray) -> np.ndarray:
        """See :meth:`MaskProvider.__call__`."""
        settings = self._settings
        alpha = np.zeros(image.shape[:2], np.float32)
        rect = x0, y0, x1, y1 = window(roi, settings.margin, image.shape[1], image.shape[0])
        if not roi.usable or x1 <= x0 or y1 <= y0:
            return alpha
        mean = np.zeros((y1 - y0, x1 - x0), np.float32)
        for view in settings.views:
            region = roi.changed(view.scale, view.rotation)
            mean += paste(self._pose(image, region, view.mirrored).mask, region, view.mirrored, rect)
        mean /= len(settings.views)
        radius = max(1, round(roi.side * settings.guide_radius))
        rows, columns = support(mean, 2 * radius)
        mean, guide = mean[rows, columns], image[y0:y1, x0:x1][rows, columns].astype(np.float32) / 255
        if not mean.size:
            return alpha
        refined = cv2.ximgproc.guidedFilter(guide, mean, radius, settings.guide_eps)
        refined = np.clip((refined - 0.5) * settings.contrast + 0.5, 0, 1)
        y0, x0 = y0 + rows.start, x0 + columns.start
        bones = skeleton(
            body - [x0, y0, 0], refined.shape, settings.min_keypoint_confidence, round(roi.side * settings.bone_width)
        )
        kept = keep_touching(refined, bones, round(roi.side * settings.fringe))
        alpha[y0 : y0 + kept.shape[0], x0 : x0 + kept.shape[1]] = kept
        return alpha
