"""Assembly of a clip: absent frames, exchanged hands, averaging, confidences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from soar.body.openpose import INDEX, LEFT_HAND, RIGHT_HAND
from soar.config import settings
from soar.perception.assemble import Observation, assemble
from soar.perception.keypoints import Keypoints
from soar.perception.mapping import ConfidenceSettings
from soar.perception.pose import MIRROR, Pose
from soar.perception.roi import Roi
from soar.perception.swaps import SwapSettings
from tests.conftest import conf
from tests.perception.test_swaps import _walker

NODE = conf("keypoints", "mediapipe")
SWAPS, CONFIDENCE = settings(SwapSettings, NODE["swaps"]), settings(ConfidenceSettings, NODE["confidence"])
TRUTH = _walker(np.full(12, 0.2))


def _pose(points: np.ndarray) -> Pose:
    world = np.concatenate([points, points[:, :1]], 1) / 500
    roi = Roi(500, 500, 800, 0.2)
    return Pose(roi, 0.9, points, np.full(33, 0.8), world, dataclasses.replace(roi, rotation=0.4), np.zeros((4, 4)))


def _observation(points: np.ndarray, mirrored: np.ndarray) -> Observation:
    return Observation(_pose(points), _pose(mirrored), np.full((21, 3), 0.1), np.full((21, 3), 0.2), None)


def _clip() -> list[Observation | None]:
    return [_observation(p, p) for p in TRUTH]


def test_absent_frames_are_zero():
    clip = _clip()
    clip[4] = None
    record, swapped = assemble(clip, [0.9] * 4 + [0.1] + [0.9] * 7, SWAPS, CONFIDENCE)
    assert record.present.tolist() == [t != 4 for t in range(12)]
    assert not record.keypoints[4].any()
    assert not record.world[4].any()
    assert record.score[4] == np.float32(0.1)
    assert record.keypoints.shape == (12, 137, 3)
    assert record.keypoints.dtype == np.float32
    assert record.disagreement.shape == (12, 25)
    assert not swapped.any()
    assert record.roi[0] == pytest.approx([500, 500, 800, 0.4])


def test_exchanged_arms_take_their_hands_along():
    clip = _clip()
    wrong = TRUTH[5][MIRROR]
    clip[5] = _observation(wrong, wrong)
    record, swapped = assemble(clip, [0.9] * 12, SWAPS, CONFIDENCE)
    assert swapped[5].all()
    assert swapped.sum() == 3
    assert (record.keypoints[5, LEFT_HAND] == np.float32(0.2)).all()
    assert (record.keypoints[4, LEFT_HAND] == np.float32(0.1)).all()
    assert (record.keypoints[5, RIGHT_HAND] == np.float32(0.1)).all()
    assert record.keypoints[5, INDEX["left_knee"], :2] == pytest.approx(TRUTH[5, 25], abs=1e-3)


def test_passes_that_agree_are_averaged_and_those_that_do_not_lose_confidence():
    clip = _clip()
    near, far = TRUTH[6].copy(), TRUTH[6].copy()
    near[25] += (6, 0)  # left knee; the torso is 200 pixels, the limit 20
    far[26] += (0, 80)  # right knee
    clip[6] = _observation(TRUTH[6], np.where(np.arange(33)[:, None] == 26, far, near))
    record, _ = assemble(clip, [0.9] * 12, SWAPS, CONFIDENCE)
    left, right = record.keypoints[6, INDEX["left_knee"]], record.keypoints[6, INDEX["right_knee"]]
    assert left == pytest.approx([TRUTH[6, 25, 0] + 3, TRUTH[6, 25, 1], 0.8], abs=1e-3)
    assert record.disagreement[6, INDEX["right_knee"]] == pytest.approx(80, abs=1e-3)
    assert right[2] == pytest.approx(0.8 / 16, rel=1e-3)
    assert right[1] == pytest.approx(TRUTH[6, 26, 1] + 80 / 32, abs=1e-2)


def test_record_survives_its_file(tmp_path):
    record, _ = assemble(_clip(), [0.9] * 12, SWAPS, CONFIDENCE)
    record.write(tmp_path / "cam.npz")
    again = Keypoints.read(tmp_path / "cam.npz")
    for field in dataclasses.fields(Keypoints):
        assert np.array_equal(getattr(again, field.name), getattr(record, field.name))
