"""A mask of one subject by an estimator that knows no subject: looked for around them, kept where it touches them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np

from soar.perception.masks import keep_touching, skeleton, window
from soar.perception.roi import Roi


@dataclasses.dataclass(frozen=True)
class RegionSettings:
    """Where a mask is looked for, and what of it is the subject's.

    Attributes:
        margin: of the tracked region: the window of the frame that is looked at; None is the whole frame.
        min_keypoint_confidence: of both ends of a bone for it to vouch for the pixels under it.
        bone_width: width of a bone, in sides of the region.
        fringe: soft edge kept around the person, in sides of the region.
    """

    margin: float | None
    min_keypoint_confidence: float
    bone_width: float
    fringe: float


Estimate = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Alpha (h, w) float32 in [0, 1] of a window (h, w, 3) uint8 RGB, given the body (25, 3) in pixels of the window."""


def subject_mask(
    estimate: Estimate, options: RegionSettings, image: np.ndarray, roi: Roi, body: np.ndarray
) -> np.ndarray:
    """The mask of a frame; arguments and result as :meth:`soar.perception.masks.MaskProvider.__call__`."""
    height, width = image.shape[:2]
    alpha = np.zeros((height, width), np.float32)
    x0, y0, x1, y1 = 0, 0, width, height
    if options.margin is not None:
        x0, y0, x1, y1 = window(roi, options.margin, width, height)
    if not roi.usable or x1 <= x0 or y1 <= y0:
        return alpha
    seen, local = image[y0:y1, x0:x1], body - [x0, y0, 0]
    found = estimate(seen, local)
    bones = skeleton(local, found.shape, options.min_keypoint_confidence, round(roi.side * options.bone_width))
    alpha[y0:y1, x0:x1] = keep_touching(found, bones, round(roi.side * options.fringe))
    return alpha


def resized(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """An image (h, w[, C]) at another size: averaged where it shrinks, bilinear where it grows."""
    shrinks = height * width < image.shape[0] * image.shape[1]
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
