"""Rotated crops: geometry, round trips, alignment rules."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from soar.perception.roi import Roi, align, around, letterbox, wrap_angle

ROIS = st.builds(
    Roi,
    st.floats(-500, 2000),
    st.floats(-500, 2000),
    st.floats(5, 3000),
    st.floats(-math.pi, math.pi, exclude_max=True),
)


def test_letterbox_of_a_portrait_frame():
    assert letterbox(1080, 1920) == Roi(540.0, 960.0, 1920.0, 0.0)


@given(roi=ROIS, mirrored=st.booleans(), x=st.floats(-300, 300), y=st.floats(-300, 300))
def test_points_return_from_the_crop(roi, mirrored, x, y):
    point = np.array([x, y])
    back = roi.to_image(roi.to_crop(point, 256, mirrored), 256, mirrored)
    assert np.allclose(back, point, atol=1e-6)


@given(roi=ROIS, mirrored=st.booleans())
def test_corners_map_to_corners(roi, mirrored):
    corners = roi.to_image(np.array([[0, 0], [256, 0], [128, 128]], float), 256, mirrored)
    assert np.isclose(np.linalg.norm(corners[1] - corners[0]), roi.side)
    assert np.allclose(corners[2], [roi.cx, roi.cy])


def test_rotation_is_clockwise_in_the_image():
    # A quarter turn clockwise: the crop's right points down in the image.
    assert np.allclose(Roi(50, 50, 20, math.pi / 2).to_image(np.array([20.0, 10.0]), 20), [50, 60])


def test_mirrored_crop_is_the_flipped_crop():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (60, 60, 3), np.uint8)
    roi = Roi(31.0, 29.0, 32.0, 0.0)
    plain = roi.crop(image, 32, border=cv2.BORDER_REPLICATE)
    mirrored = roi.crop(image, 32, border=cv2.BORDER_REPLICATE, mirrored=True)
    # Tensor corners lie on the region's corners, so pixel i of one is pixel 32 - i of the other.
    assert np.array_equal(mirrored[:, 1:], plain[:, :0:-1])


def test_crop_at_scale_one_copies_pixels():
    image = np.random.default_rng(1).integers(0, 256, (40, 50, 3), np.uint8)
    assert np.array_equal(Roi(20.0, 18.0, 16.0, 0.0).crop(image, 16, border=cv2.BORDER_CONSTANT), image[10:26, 12:28])


def test_borders():
    image = np.full((20, 20, 3), 200, np.uint8)
    roi = Roi(0.0, 10.0, 20.0, 0.0)
    assert roi.crop(image, 20, border=cv2.BORDER_CONSTANT)[10, 2, 0] == 0
    assert roi.crop(image, 20, border=cv2.BORDER_REPLICATE)[10, 2, 0] == 200


@pytest.mark.parametrize(("rim", "rotation"), [((100, 40), 0.0), ((160, 100), math.pi / 2), ((40, 100), -math.pi / 2)])
def test_align_turns_the_direction_up(rim, rotation):
    roi = align(np.array([100.0, 100.0]), np.array(rim, float), target=math.pi / 2, scale=1.25)
    assert roi == Roi(100.0, 100.0, 150.0, pytest.approx(rotation))
    u, v = roi.to_crop(np.array(rim, float), 1.0)
    assert u == pytest.approx(0.5)
    assert v < 0.5


def test_align_shifts_by_the_unscaled_side_along_the_turned_axis():
    roi = align(np.array([100.0, 100.0]), np.array([160.0, 100.0]), target=math.pi / 2, scale=3.0, shift_y=-0.1)
    # Turned by a quarter clockwise, "up" in the crop is right in the image.
    assert (roi.cx, roi.cy, roi.side) == pytest.approx((112.0, 100.0, 360.0))


def test_around_uses_the_longer_edge_and_shifts_by_the_height():
    points = np.array([[10.0, 10.0], [50.0, 30.0]])
    roi = around(points, np.array([10.0, 20.0]), np.array([50.0, 20.0]), target=0.0, scale=2.0, shift_y=-0.1)
    assert (roi.cx, roi.cy, roi.side, roi.rotation) == pytest.approx((30.0, 18.0, 80.0, 0.0))


@given(st.floats(-50, 50))
def test_wrap_angle(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle))
    assert math.sin(wrapped) == pytest.approx(math.sin(angle))


def test_overlap_against_pixel_counting():
    grid_y, grid_x = np.mgrid[0:200, 0:200] + 0.5
    a, b = Roi(80, 90, 60, 0), Roi(100, 110, 100, 1.0)
    inside = [(abs(grid_x - r.cx) < r.side / 2) & (abs(grid_y - r.cy) < r.side / 2) for r in (a, b)]
    assert a.overlap(b) == pytest.approx((inside[0] & inside[1]).sum() / (inside[0] | inside[1]).sum())
    assert a.overlap(Roi(1000, 90, 60, 0)) == 0
    assert a.overlap(a) == 1


def test_straightened_keeps_part_of_a_lean_but_not_of_a_handstand():
    assert Roi(0, 0, 9, 0.8).straightened(0.5).rotation == pytest.approx(0.4)
    assert Roi(0, 0, 9, -3.0).straightened(0.5).rotation == -3.0


@pytest.mark.parametrize("roi", [Roi(math.nan, 0, 10, 0), Roi(0, 0, 1.0, 0), Roi(0, 0, math.inf, 0)])
def test_degenerate_regions_are_not_usable(roi):
    assert not roi.usable
