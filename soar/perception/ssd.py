"""Decoding of single-shot detectors: anchor grids, box and keypoint regression, weighted non-maximum suppression."""

from __future__ import annotations

import dataclasses

import numpy as np

SCORE_LOGIT_LIMIT = 80.0  # keeps exp() finite in float32


@dataclasses.dataclass(frozen=True)
class AnchorGrid:
    """Layout of a detector's anchors.

    Attributes:
        size: edge length of the input tensor, pixels.
        strides: one per prediction layer, pixels; consecutive equal strides share a grid.
        anchors_per_layer: anchors of one layer at one cell.
    """

    size: int
    strides: tuple[int, ...]
    anchors_per_layer: int = 2

    def centres(self) -> np.ndarray:
        """(A, 2) anchor centres in [0, 1], ordered by layer, row, column, anchor."""
        grids = []
        for stride in dict.fromkeys(self.strides):
            cells = -(-self.size // stride)
            ticks = (np.arange(cells) + 0.5) / cells
            y, x = np.meshgrid(ticks, ticks, indexing="ij")
            repeats = self.anchors_per_layer * self.strides.count(stride)
            grids.append(np.repeat(np.stack([x.ravel(), y.ravel()], 1), repeats, axis=0))
        return np.concatenate(grids)


POSE_ANCHORS = AnchorGrid(224, (8, 16, 32, 32, 32))
FACE_ANCHORS = AnchorGrid(128, (8, 16, 16, 16))


@dataclasses.dataclass(frozen=True)
class Detection:
    """One detection in normalised coordinates of the detector's tensor.

    Attributes:
        score: in [0, 1].
        box: (4,) x0, y0, x1, y1.
        keypoints: (K, 2).
    """

    score: float
    box: np.ndarray
    keypoints: np.ndarray


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Logistic function without overflow."""
    return 1 / (1 + np.exp(-np.clip(x, -SCORE_LOGIT_LIMIT, SCORE_LOGIT_LIMIT)))


def decode(raw: np.ndarray, logits: np.ndarray, grid: AnchorGrid, min_score: float) -> list[Detection]:
    """Turn raw predictions into detections above ``min_score``, in anchor order.

    Args:
        raw: (A, 4 + 2 K) box centre, box size and keypoints, in pixels of the tensor relative to the anchor.
        logits: (A,).
        grid: the anchors that the network was trained with.
    """
    scores = sigmoid(logits.astype(np.float64))
    keep = np.flatnonzero(scores >= min_score)
    anchors = grid.centres()[keep]
    points = raw[keep].reshape(len(keep), raw.shape[1] // 2, 2).astype(np.float64) / grid.size
    centre, size, keypoints = points[:, 0] + anchors, points[:, 1], points[:, 2:] + anchors[:, None]
    boxes = np.concatenate([centre - size / 2, centre + size / 2], 1)
    return [Detection(float(s), b, k) for s, b, k in zip(scores[keep], boxes, keypoints, strict=True)]


def box_iou(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Intersection over union of ``box`` (4,) with ``boxes`` (N, 4): (N,)."""
    shared = np.prod(np.clip(np.minimum(box[2:], boxes[:, 2:]) - np.maximum(box[:2], boxes[:, :2]), 0, None), axis=1)
    area = np.prod(np.clip(box[2:] - box[:2], 0, None))
    areas = np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0, None), axis=1)
    return shared / np.maximum(area + areas - shared, np.finfo(np.float64).tiny)


def weighted_nms(detections: list[Detection], max_iou: float) -> list[Detection]:
    """Merge overlapping detections by their score-weighted mean, best first.

    Each round takes the best remaining detection and averages boxes and keypoints of all that overlap it by more than
    ``max_iou``, as the BlazeFace authors propose against jitter; the result keeps the best one's score.
    """
    remaining = sorted(detections, key=lambda d: -d.score)
    merged = []
    while remaining:
        best = remaining[0]
        close = box_iou(best.box, np.stack([d.box for d in remaining])) > max_iou
        close[0] = True
        group = [d for d, c in zip(remaining, close, strict=True) if c]
        weights = np.array([d.score for d in group])
        weights = weights / weights.sum()
        box = np.tensordot(weights, np.stack([d.box for d in group]), 1)
        keypoints = np.tensordot(weights, np.stack([d.keypoints for d in group]), 1)
        merged.append(Detection(best.score, box, keypoints))
        remaining = [d for d, c in zip(remaining, close, strict=True) if not c]
    return merged
