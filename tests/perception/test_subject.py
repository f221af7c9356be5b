"""Choice of the subject: prominence, rivals, the user's word."""

from __future__ import annotations

import pytest

from soar.config import settings
from soar.errors import SubjectError
from soar.perception.detector import Person
from soar.perception.keypoints import Choice
from soar.perception.roi import Roi
from soar.perception.subject import SubjectSettings, chosen, distinct, most_prominent
from tests.conftest import conf

OPTIONS = settings(SubjectSettings, conf("keypoints", "mediapipe")["subject"])
WIDTH, HEIGHT = 1080, 1920


def _person(x: float, y: float, side: float, score: float = 0.9) -> Person:
    return Person(score, Roi(x, y, side, 0.0))


LARGE, SMALL = _person(540, 900, 900), _person(200, 500, 250)


def test_the_larger_central_person_is_taken_in_the_best_frame():
    best = _person(545, 960, 950, 0.98)
    start = most_prominent([[SMALL, LARGE], [SMALL, best], [LARGE]], WIDTH, HEIGHT, OPTIONS)
    assert (start.frame, start.roi) == (1, best.roi)
    assert 0 < start.rivalry < OPTIONS.rival_remark


def test_size_counts_more_than_score_and_centre_breaks_a_tie():
    start = most_prominent([[_person(200, 500, 250, 0.99), _person(600, 900, 900, 0.7)]], WIDTH, HEIGHT, OPTIONS)
    assert start.roi.side == 900
    start = most_prominent([[_person(100, 900, 500), _person(500, 950, 500)]], WIDTH, HEIGHT, OPTIONS)
    assert start.roi.cx == 500


def test_two_equal_people_are_refused_with_their_places():
    with pytest.raises(SubjectError, match="equally likely") as error:
        most_prominent([[_person(340, 900, 800), _person(740, 900, 800)]] * 5, WIDTH, HEIGHT, OPTIONS)
    assert "[340,900]" in str(error.value)
    assert "dataset.subject.point" in str(error.value)


def test_a_rival_in_few_frames_is_only_a_number():
    clip = [[LARGE]] * 4 + [[_person(340, 900, 800), _person(740, 900, 800)]]
    assert most_prominent(clip, WIDTH, HEIGHT, OPTIONS).rivalry == 0


def test_nobody():
    with pytest.raises(SubjectError, match="no person") as error:
        most_prominent([[], []], WIDTH, HEIGHT, OPTIONS)
    assert "2 frames" in error.value.got


def test_one_body_detected_twice_is_one_person():
    twice = [_person(540, 900, 900), _person(560, 920, 850, 0.8)]
    assert distinct(twice, OPTIONS.same_person_overlap) == twice[:1]
    most_prominent([twice] * 3, WIDTH, HEIGHT, OPTIONS)


def test_a_point_chooses_the_person_under_it():
    start = chosen([[], [LARGE, SMALL]], Choice(1, (180.0, 520.0), None))
    assert (start.frame, start.roi) == (1, SMALL.roi)


def test_a_point_on_nobody_says_who_is_there():
    with pytest.raises(SubjectError, match="nobody was found at point") as error:
        chosen([[SMALL]], Choice(0, (900.0, 1800.0), None))
    assert "[200,500]" in error.value.got


def test_a_box_takes_the_detection_or_stands_for_itself():
    assert chosen([[LARGE, SMALL]], Choice(0, None, (100, 400, 300, 600))).roi == SMALL.roi
    alone = chosen([[LARGE]], Choice(0, None, (20, 1500, 120, 1800))).roi
    assert (alone.cx, alone.cy, alone.side) == (70, 1650, 375)


def test_a_frame_outside_the_clip():
    with pytest.raises(SubjectError, match="frame 3, which does not exist"):
        chosen([[LARGE]], Choice(3, (1.0, 1.0), None))
