"""The whole estimate with stand-in networks, and the real networks where they are fetched."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest

from soar.config import settings
from soar.errors import ConfigError, ModelFileError, SubjectError
from soar.perception.assemble import Observation
from soar.perception.detector import Person, PersonDetector
from soar.perception.diagnostics import disagreement, jitter
from soar.perception.drawing import LEFT_COLOUR, RIGHT_COLOUR, draw_skeleton
from soar.perception.hands import HandNetwork, hand_roi
from soar.perception.keypoints import Choice
from soar.perception.mediapipe import MediaPipeSettings, estimate
from soar.perception.pose import MIRROR, Pose, PoseNetwork
from soar.perception.registry import keypoint_provider, mask_provider
from soar.perception.roi import Roi
from tests.conftest import conf, model_file
from tests.perception.test_swaps import _walker

OPTIONS = settings(MediaPipeSettings, conf("keypoints", "mediapipe"))
COUNT = 10
TRUTH = _walker(np.full(COUNT, 0.2))


def _frames(count: int = COUNT) -> list[np.ndarray]:
    """Frames that carry their own number in every pixel."""
    return [np.full((1000, 1000, 3), t, np.uint8) for t in range(count)]


def _region(t: int) -> Roi:
    return Roi(500.0 + 2 * t, 480.0, 900.0, 0.0)


def _detect(image: np.ndarray) -> list[Person]:
    return [Person(0.9, _region(int(image[0, 0, 0])))]


def _observe(image: np.ndarray, roi: Roi, hidden: tuple[int, ...] = ()) -> Observation:
    t = int(image[0, 0, 0])
    presence = 0.1 if t in hidden or abs(roi.cx - _region(t).cx) > 100 else 0.95
    world = np.concatenate([TRUTH[t], TRUTH[t][:, :1]], 1) / 500
    pose = Pose(roi, presence, TRUTH[t], np.full(33, 0.9), world, _region(t), np.zeros((4, 4)))
    return Observation(pose, pose, np.zeros((21, 3)), np.zeros((21, 3)), None)


def _glance(image: np.ndarray, roi: Roi) -> Pose:
    return _observe(image, roi).pose


def _keypoints(node, files, threads):
    return keypoint_provider(node, files, threads, None, "camera")


def test_a_clip_with_one_person():
    record, report = estimate(_frames(), None, _detect, _observe, _glance, OPTIONS)
    assert record.present.all()
    assert report.reacquired == 0
    assert not report.swapped.any()
    assert report.remarks == ()
    assert np.allclose(record.keypoints[:, 5, :2], TRUTH[:, 11], atol=1e-3)
    assert jitter(record) == pytest.approx(0, abs=1e-5)
    assert disagreement(record) == 0


def test_one_frame_is_refused_with_the_number_that_is_needed():
    with pytest.raises(SubjectError, match="too short") as error:
        estimate(_frames(1), None, _detect, _observe, _glance, OPTIONS)
    assert error.value.expected == f"at least {OPTIONS.min_frames} frames"


def test_a_person_seen_too_rarely_is_refused():
    with pytest.raises(SubjectError, match="too few frames") as error:
        estimate(_frames(), None, _detect, lambda i, r: _observe(i, r, hidden=tuple(range(1, 7))), _glance, OPTIONS)
    assert error.value.got.startswith("4 frames")


def test_a_prominent_bystander_is_remarked_upon():
    def detect(image: np.ndarray) -> list[Person]:
        return [*_detect(image), Person(0.9, Roi(120.0, 480.0, 800.0, 0.0))]

    options = dataclasses.replace(OPTIONS, subject=dataclasses.replace(OPTIONS.subject, rival_remark=0.3))
    _, report = estimate(_frames(), None, detect, _observe, _glance, options)
    assert 0.3 < report.rivalry < OPTIONS.subject.rival_error
    assert "dataset.subject.point" in report.remarks[0]


def test_the_users_choice_starts_the_track():
    _, report = estimate(_frames(), Choice(3, (505.0, 480.0), None), _detect, _observe, _glance, OPTIONS)
    assert report.start == 3


@pytest.mark.parametrize("build", [_keypoints, mask_provider])
def test_unknown_provider(build, tmp_path):
    with pytest.raises(ConfigError, match="unknown provider"):
        build({"provider": "magic"}, {"models": tmp_path}, 1)


@pytest.mark.parametrize(("build", "group"), [(_keypoints, "keypoints"), (mask_provider, "masks")])
def test_missing_network(build, group, tmp_path):
    with pytest.raises(ModelFileError, match="missing"):
        build(conf(group, "mediapipe"), {"models": tmp_path}, 1)


def test_hand_region_points_along_the_hand():
    roi = hand_roi(np.array([100.0, 200.0]), np.array([95.0, 140.0]), np.array([110.0, 140.0]))
    # Knuckles are 60 pixels above the wrist: side 2.7 * 2 * 60, shifted up by a tenth of 2 * 60.
    assert (roi.cx, roi.cy, roi.side, roi.rotation) == pytest.approx((100, 128, 324, 0))


def test_drawing_colours_sides_and_fades_doubt():
    image, keypoints = np.zeros((600, 1000, 3), np.uint8), np.zeros((137, 3))
    keypoints[[5, 6]] = [[700, 100, 1.0], [700, 300, 1.0]]  # left upper arm
    keypoints[[2, 3]] = [[300, 100, 0.5], [300, 300, 0.5]]  # right upper arm
    drawn = draw_skeleton(image, keypoints, 5)
    assert tuple(drawn[200, 700]) == LEFT_COLOUR
    assert tuple(drawn[200, 300]) == pytest.approx([c / 2 for c in RIGHT_COLOUR], abs=1)
    assert not drawn[:, 500].any()


def test_network_with_other_outputs(tmp_path):
    shutil.copy(model_file("face_landmark.onnx"), tmp_path / "pose_landmark_full.onnx")
    with pytest.raises(ModelFileError, match="other outputs"):
        PoseNetwork(tmp_path / "pose_landmark_full.onnx", 1)


def test_nobody_on_an_empty_frame():
    detector = PersonDetector(model_file("pose_detection.onnx"), 1, OPTIONS.min_detection)
    assert detector(np.full((192, 108, 3), 90, np.uint8)) == []


def test_the_mirrored_pass_of_a_mirrored_frame_is_the_direct_pass():
    network = PoseNetwork(model_file("pose_landmark_full.onnx"), 1)
    image = np.random.default_rng(0).integers(0, 256, (24, 20, 3), np.uint8).repeat(16, 0).repeat(16, 1)
    roi, width = Roi(150.0, 180.0, 240.0, 0.25), image.shape[1]
    direct = network(image, roi)
    # Pixel centres sit at whole numbers in the crop's map, so the frame flips about (width - 1) / 2.
    # Resampling rounds to 1/32 pixel, which differs between the two; exchanged sides would be tens of pixels off.
    flipped = network(image[:, ::-1].copy(), Roi(width - 1 - roi.cx, roi.cy, roi.side, -roi.rotation), mirrored=True)
    assert flipped.presence == pytest.approx(direct.presence, abs=0.01)
    assert flipped.points[MIRROR] == pytest.approx(direct.points * (-1, 1) + (width - 1, 0), abs=0.5)
    assert flipped.world[MIRROR] == pytest.approx(direct.world * (-1, 1, 1), abs=0.01)
    assert flipped.visibility[MIRROR] == pytest.approx(direct.visibility, abs=0.01)


def test_hands_are_not_looked_for_at_an_invisible_wrist():
    network = HandNetwork(model_file("hand_landmark_full.onnx").parent, 1)
    pose = dataclasses.replace(_observe(_frames(1)[0], _region(0)).pose, visibility=np.zeros(33))
    assert not network(_frames(1)[0], pose, "left").any()
