from __future__ import annotations

import numpy as np
import pytest

from soar.errors import CalibrationError
from soar.geometry.cameras import Camera


def camera(**change) -> Camera:
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    T = np.eye(4)
    T[:3, 3] = [0.1, -0.2, 3.0]
    base = {
        "name": "c",
        "width": 640,
        "height": 480,
        "K": K,
        "T_cam_from_world": T,
        "distortion": np.zeros(5),
        "K_source": "x",
    }
    return Camera(**(base | change))


def test_projects_by_hand() -> None:
    assert np.allclose(camera().project(np.array([[0.0, 0, 0]])), [[320 + 500 * 0.1 / 3, 240 - 510 * 0.2 / 3]])


def test_centre_maps_to_the_origin_of_the_camera() -> None:
    c = camera()
    assert np.allclose(c.to_camera(c.centre), 0)


def test_resize_then_crop_moves_pixels_with_the_image() -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    full = camera().project(points)
    half = camera().resized(320, 240).cropped(10, -4, 100, 50)
    assert np.allclose(half.project(points), full / 2 - [10, -4])


def test_json_round_trip() -> None:
    c = camera()
    back = Camera.from_json(c.to_json())
    assert np.array_equal(back.K, c.K)
    assert back.name == c.name


@pytest.mark.parametrize(
    "change",
    [
        {"K": np.eye(4)},
        {"K": np.diag([-1.0, 1, 1])},
        {"T_cam_from_world": np.diag([1.0, 1, -1, 1])},
        {"T_cam_from_world": np.diag([2.0, 2, 2, 1])},
        {"T_cam_from_world": np.full((4, 4), np.nan)},
        {"width": 0},
    ],
)
def test_malformed_cameras_are_named(change: dict) -> None:
    with pytest.raises(CalibrationError, match="camera c"):
        camera(**change)
    with pytest.raises(CalibrationError):
        Camera.from_json({"name": "c"})
