"""Anchors, decoding and weighted non-maximum suppression."""

from __future__ import annotations

import numpy as np
import pytest

from soar.perception.ssd import (
    FACE_ANCHORS,
    POSE_ANCHORS,
    AnchorGrid,
    Detection,
    box_iou,
    decode,
    sigmoid,
    weighted_nms,
)


def test_anchor_counts():
    assert POSE_ANCHORS.centres().shape == (2254, 2)
    assert FACE_ANCHORS.centres().shape == (896, 2)


def test_anchor_order_is_layer_row_column_anchor():
    grid = AnchorGrid(8, (4, 8, 8), 2).centres()
    assert grid[:8].tolist() == [[x, y] for y in (0.25, 0.75) for x in (0.25, 0.75) for _ in range(2)]
    assert grid[8:].tolist() == [[0.5, 0.5]] * 4


def test_sigmoid_survives_extreme_float32():
    with np.errstate(over="raise"):
        assert sigmoid(np.array([-1e4, 0, 1e4], np.float32)) == pytest.approx([0, 0.5, 1])


def test_decode_places_box_and_keypoints_at_the_anchor():
    raw, logits = np.zeros((896, 16), np.float32), np.full(896, -9.0, np.float32)
    raw[300, :6] = [6.4, -6.4, 12.8, 25.6, 1.28, 2.56]
    logits[300] = 2.0
    (found,) = decode(raw, logits, FACE_ANCHORS, 0.5)
    cx, cy = FACE_ANCHORS.centres()[300] + [0.05, -0.05]
    assert found.score == pytest.approx(1 / (1 + np.exp(-2.0)))
    assert found.box == pytest.approx([cx - 0.05, cy - 0.1, cx + 0.05, cy + 0.1])
    assert found.keypoints[0] == pytest.approx(FACE_ANCHORS.centres()[300] + [0.01, 0.02])
    assert found.keypoints.shape == (6, 2)


def test_decode_of_nothing_is_empty():
    assert decode(np.zeros((896, 16)), np.full(896, -9.0), FACE_ANCHORS, 0.5) == []
    assert weighted_nms([], 0.3) == []


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    w = max(0.0, min(a[2], b[2]) - max(a[0], b[0]))
    h = max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    return w * h / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - w * h)


def _brute_force(detections: list[Detection], limit: float) -> list[tuple[float, list[float]]]:
    left, result = sorted(detections, key=lambda d: d.score, reverse=True), []
    while left:
        group = [d for d in left if d is left[0] or _iou(left[0].box, d.box) > limit]
        total = sum(d.score for d in group)
        result.append((left[0].score, [sum(d.score * d.box[i] for d in group) / total for i in range(4)]))
        left = [d for d in left if all(d is not g for g in group)]
    return result


@pytest.mark.parametrize("seed", range(5))
def test_weighted_nms_against_loops(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(0, 0.7, (40, 2))
    boxes = np.concatenate([low, low + rng.uniform(0.05, 0.3, (40, 2))], 1)
    detections = [Detection(float(s), b, b[:2][None]) for s, b in zip(rng.uniform(0.5, 1, 40), boxes, strict=True)]
    merged, expected = weighted_nms(detections, 0.3), _brute_force(detections, 0.3)
    assert 1 < len(merged) < 40
    assert [m.score for m in merged] == [s for s, _ in expected]
    assert np.allclose([m.box for m in merged], [b for _, b in expected])
    assert np.allclose([m.keypoints[0] for m in merged], [b[:2] for _, b in expected])


def test_iou_of_degenerate_boxes_is_zero():
    assert box_iou(np.zeros(4), np.array([[0, 0, 0, 0], [0.0, 0, 1, 1]])).tolist() == [0, 0]
