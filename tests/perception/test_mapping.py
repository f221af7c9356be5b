"""The mapping to the 137 keypoints, by name."""

from __future__ import annotations

import numpy as np
import pytest

from soar.body.openpose import BODY, COUNT, FACE, LEFT_HAND, NAMES, RIGHT_HAND
from soar.body.openpose import INDEX as KEYPOINT
from soar.perception.face import Face
from soar.perception.mapping import FACE_MESH, agreement, body_confidence, body_points, face_keypoints
from soar.perception.pose import INDEX as LANDMARK

# BODY_25 index -> BlazePose index, written out once more, independently of the names.
DIRECT = {0: 0, 2: 12, 3: 14, 4: 16, 5: 11, 6: 13, 7: 15, 9: 24, 10: 26, 11: 28, 12: 23, 13: 25, 14: 27, 15: 5, 16: 2,
          17: 8, 18: 7, 19: 31, 21: 29, 22: 32, 24: 30}  # fmt: skip


def test_every_body_keypoint():
    points = np.random.default_rng(0).normal(size=(2, 33, 2))
    body = body_points(points)
    assert body.shape == (2, 25, 2)
    for keypoint, landmark in DIRECT.items():
        assert np.array_equal(body[:, keypoint], points[:, landmark]), BODY[keypoint]
    assert np.allclose(body[:, 1], (points[:, 11] + points[:, 12]) / 2)
    assert np.allclose(body[:, 8], (points[:, 23] + points[:, 24]) / 2)
    assert not body[:, [20, 23]].any()


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("part", ["shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "eye", "ear"])
def test_sides_by_name(side, part):
    marked = np.zeros((33, 1))
    marked[LANDMARK[f"{side}_{part}"]] = 1
    body = body_points(marked)[:, 0]
    assert body[KEYPOINT[f"{side}_{part}"]] == 1
    other = "right" if side == "left" else "left"
    assert body[KEYPOINT[f"{other}_{part}"]] == 0


def test_confidences():
    visibility = np.full(33, 0.8)
    visibility[LANDMARK["left_shoulder"]] = 0.3
    confidence = dict(zip(BODY, body_confidence(visibility, 0.5), strict=True))
    assert confidence["neck"] == 0.3
    assert confidence["mid_hip"] == 0.8
    assert confidence["left_big_toe"] == pytest.approx(0.4)
    assert confidence["left_small_toe"] == 0
    assert confidence["right_heel"] == 0.8


def test_order_of_the_parts():
    assert (COUNT, LEFT_HAND.start, RIGHT_HAND.start, FACE.start, FACE.stop) == (137, 25, 46, 67, 137)
    assert NAMES[LEFT_HAND.start] == "left_hand_wrist"
    assert NAMES[136] == "left_pupil"


def test_face():
    mesh = np.random.default_rng(0).normal(size=(468, 2))
    face = face_keypoints(Face(mesh, 0.9), jaw=0.3)
    assert len(FACE_MESH) == 68
    assert FACE_MESH.max() < 468
    assert len(set(FACE_MESH.tolist())) == 68
    assert np.array_equal(face[30, :2], mesh[4])  # tip of the nose
    assert np.array_equal(face[8, :2], mesh[152])  # chin
    assert np.array_equal(face[36, :2], mesh[33])
    assert np.array_equal(face[45, :2], mesh[263])
    assert np.allclose(face[68, :2], mesh[[33, 160, 158, 133, 153, 144]].mean(0))
    assert face[0, 2] == pytest.approx(0.27)
    assert face[30, 2] == 0.9
    assert not face_keypoints(None, jaw=0.3).any()


def test_agreement_falls_off_beyond_the_limit():
    trust = agreement(np.array([[0.0, 5.0, 10.0, 20.0]]), np.array([[10.0]]))
    assert trust[0] == pytest.approx([1, 1, 1, 0.25])
