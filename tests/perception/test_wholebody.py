"""COCO-WholeBody's 133 keypoints as OpenPose's 137, by name."""

from __future__ import annotations

import numpy as np

from soar.body.openpose import BODY, FACE, INDEX, LEFT_HAND, RIGHT_HAND, mirror
from soar.perception.wholebody import BODY_AND_FEET, SOURCES, openpose_137


def _numbered() -> np.ndarray:
    """Keypoints whose x is their number, y ten times that, with falling confidence."""
    k = np.arange(133.0)
    return np.stack([k, 10 * k, 1 - k / 200], -1)


def test_body_by_name() -> None:
    found = openpose_137(_numbered())
    for i, name in enumerate(BODY_AND_FEET):
        np.testing.assert_array_equal(found[INDEX[name]], _numbered()[i])
    np.testing.assert_allclose(found[INDEX["neck"]], (5.5, 55, 1 - 6 / 200))
    np.testing.assert_allclose(found[INDEX["mid_hip"]], (11.5, 115, 1 - 12 / 200))
    assert set(BODY) == {*BODY_AND_FEET, "neck", "mid_hip"}


def test_hands_face_and_pupils() -> None:
    found = openpose_137(_numbered())
    np.testing.assert_array_equal(found[LEFT_HAND, 0], np.arange(91, 112))
    np.testing.assert_array_equal(found[RIGHT_HAND, 0], np.arange(112, 133))
    np.testing.assert_array_equal(found[FACE, 0][:68], np.arange(23, 91))
    # OpenPose: right pupil first; the lids of the right eye are iBUG's 36 to 41.
    np.testing.assert_allclose(found[FACE][68:, 0], (np.arange(59, 65).mean(), np.arange(65, 71).mean()))


def test_golden_table() -> None:
    """The published table of the conversion, body and feet."""
    body = [0, (5, 6), 6, 8, 10, 5, 7, 9, (11, 12), 12, 14, 16, 11, 13, 15, 2, 1, 4, 3, 17, 18, 19, 20, 21, 22]
    assert SOURCES[:25] == [(k,) if isinstance(k, int) else k for k in body]


def test_sides_of_the_133_are_those_of_the_137() -> None:
    """Exchanging sides before and after the conversion is the same."""
    names = {name: i for i, name in enumerate(BODY_AND_FEET)}
    order = np.arange(133)
    for name, i in names.items():
        if "left_" in name:
            j = names[name.replace("left_", "right_")]
            order[[i, j]] = j, i
    order[91:112], order[112:133] = np.arange(112, 133), np.arange(91, 112)
    faces = mirror()[FACE][:68] - FACE.start
    order[23:91] = faces + 23
    np.testing.assert_allclose(openpose_137(_numbered()[order]), openpose_137(_numbered())[mirror()])


def test_any_leading_axes() -> None:
    stacked = np.stack([_numbered(), 2 * _numbered()])
    np.testing.assert_allclose(openpose_137(stacked)[1], openpose_137(stacked[1]))
    assert openpose_137(np.zeros((0, 133, 3))).shape == (0, 137, 3)
