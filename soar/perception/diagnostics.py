"""Numbers that tell whether keypoints and masks of a clip can be trusted."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from soar.body.openpose import BODY, INDEX
from soar.perception.keypoints import Keypoints

TRUSTED = 0.5  # confidence from which a keypoint counts in the numbers below


def torso_pixels(keypoints: np.ndarray) -> np.ndarray:
    """(T,) distance between neck and middle of the hips of keypoints (T, 137, 3), pixels."""
    return np.linalg.norm(keypoints[:, INDEX["neck"], :2] - keypoints[:, INDEX["mid_hip"], :2], axis=-1)


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def jitter(record: Keypoints) -> float:
    """Median second difference in time of the trusted body keypoints, in torso lengths; NaN for under three frames."""
    body = record.keypoints[:, : len(BODY)]
    trusted = body[..., 2] >= TRUSTED
    both = trusted[2:] & trusted[1:-1] & trusted[:-2]
    bend = np.linalg.norm(body[2:, :, :2] - 2 * body[1:-1, :, :2] + body[:-2, :, :2], axis=-1)
    unit = np.maximum(torso_pixels(record.keypoints)[1:-1, None], 1.0)
    return _median((bend / unit)[both])


def disagreement(record: Keypoints) -> float:
    """Median distance between the direct and the mirrored pass over found body keypoints, in torso lengths."""
    found = record.present[:, None] & (record.keypoints[:, : len(BODY), 2] > 0)
    unit = np.maximum(torso_pixels(record.keypoints)[:, None], 1.0)
    return _median((record.disagreement / unit)[found])


@dataclasses.dataclass(frozen=True)
class MaskFigures:
    """Of one mask: area in pixels at alpha > 1/2, number of components, and whether it touches the image border."""

    area: int
    components: int
    at_border: bool


def mask_figures(alpha: np.ndarray) -> MaskFigures:
    """Measure one mask (H, W) in [0, 1]."""
    inside = alpha > 0.5
    components = cv2.connectedComponents(inside.astype(np.uint8), connectivity=8)[0] - 1
    edge = inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any()
    return MaskFigures(int(inside.sum()), components, bool(edge))


def area_jitter(areas: np.ndarray) -> float:
    """Median second difference in time of mask areas (T,), as a share of the median area; NaN if undefined."""
    full = areas > 0
    rows = full[2:] & full[1:-1] & full[:-2]
    bend = np.abs(areas[2:] - 2 * areas[1:-1] + areas[:-2])[rows]
    return _median(bend / np.median(areas[full])) if rows.any() else float("nan")
