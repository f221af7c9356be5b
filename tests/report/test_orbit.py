"""Cameras round a body."""

from __future__ import annotations

import numpy as np
import pytest

from soar.report.orbit import Orbit

UP, FRONT = np.array([0.0, 0.0, 2.0]), np.array([0.0, -1.0, 0.3])


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.5, -0.2, 0.1], [0.7, 0.4, 1.9], (400, 3))


@pytest.fixture
def orbit(points: np.ndarray) -> Orbit:
    return Orbit.around(points, UP, FRONT, height=200, fov=0.5, margin=0.05)


@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 9))
def test_every_camera_sees_the_whole_body(points: np.ndarray, orbit: Orbit, angle: float) -> None:
    T = orbit.T_cam_from_world(angle)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    pixels = (points @ T[:3, :3].T + T[:3, 3]) @ orbit.K.T
    x, y = (pixels[:, :2] / pixels[:, 2:]).T
    assert pixels[:, 2].min() > 0
    assert 0.04 * orbit.width <= x.min()
    assert x.max() <= 0.96 * orbit.width
    assert 0.04 * orbit.height <= y.min()
    assert y.max() <= 0.96 * orbit.height


def test_the_body_fills_the_image(points: np.ndarray, orbit: Orbit) -> None:
    heights = []
    for angle in np.linspace(0, 2 * np.pi, 36):
        T = orbit.T_cam_from_world(angle)
        p = (points @ T[:3, :3].T + T[:3, 3]) @ orbit.K.T
        heights.append(np.ptp(p[:, 1] / p[:, 2]))
    assert max(heights) > 0.7 * orbit.height


def test_front_first_then_the_left_hand_side(orbit: Orbit) -> None:
    def centre(angle: float) -> np.ndarray:
        T = orbit.T_cam_from_world(angle)
        return (-T[:3, :3].T @ T[:3, 3] - orbit.centre) / orbit.distance

    np.testing.assert_allclose(centre(0.0), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(centre(np.pi / 2), [1, 0, 0], atol=1e-12)
    up_in_image = orbit.T_cam_from_world(1.0)[:3, :3] @ [0, 0, 1]
    np.testing.assert_allclose(up_in_image, [0, -1, 0], atol=1e-12)
