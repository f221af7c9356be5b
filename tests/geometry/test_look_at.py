"""The upright camera: a rotation, its target on the axis, the scene's up pointing up in the picture."""

import numpy as np
import pytest

from soar.geometry.cameras import look_at


def unit(vector: tuple[float, float, float] | np.ndarray) -> np.ndarray:
    return np.asarray(vector, float) / np.linalg.norm(vector)


CASES = [
    ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), 1.0),
    ((1.0, -2.0, 0.5), (0.3, 0.9, -0.2), (0.0, 0.0, 1.0), 4.0),
    ((0.2, 0.4, 3.0), (-1.0, 0.5, 0.1), (0.0, -1.0, 0.0), 2.5),
    ((-5.0, 1.0, 1.0), (0.2, -0.1, 0.8), (0.6, 0.0, 0.8), 0.7),
]


@pytest.mark.parametrize(("centre", "forward", "up", "distance"), CASES)
def test_look_at(centre: tuple, forward: tuple, up: tuple, distance: float) -> None:
    centre, forward, up = np.array(centre), unit(forward), unit(up)
    T = look_at(centre, forward, up, distance)
    R = T[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_array_equal(T[3], [0, 0, 0, 1])

    def seen(point: np.ndarray) -> np.ndarray:
        return R @ point + T[:3, 3]

    np.testing.assert_allclose(seen(centre), [0, 0, distance], atol=1e-12)
    np.testing.assert_allclose(seen(centre - distance * forward), 0, atol=1e-12)  # where the camera stands
    above = seen(centre + 0.1 * up)
    assert above[0] == pytest.approx(0, abs=1e-12)  # upright: no roll
    assert above[1] < 0
    right = seen(centre + 0.1 * np.cross(forward, up))
    assert right[0] > 0
    np.testing.assert_allclose(right[1:], [0, distance], atol=1e-12)
