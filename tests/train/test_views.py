"""Random cameras: the person lies in the window as the settings say, upright, from all around."""

import dataclasses

import numpy as np
import pytest

from soar.config import settings
from soar.train.views import ViewSettings, random_shot
from tests.conftest import conf

VIEW = settings(ViewSettings, conf("train", "normals")["samples"]["view"])
UP = np.array([0.0, 0.0, 1.0])
BOX = np.array([[3 + x, y - 2, 5 + z] for x in (-0.4, 0.4) for y in (-0.2, 0.2) for z in (0.0, 1.7)])


def pixels(shot, points):
    seen = points @ shot.T_cam_from_world[:3, :3].T + shot.T_cam_from_world[:3, 3]
    assert (seen[:, 2] > 0).all()
    p = shot.pinhole
    return np.stack([p.fx * seen[:, 0] / seen[:, 2] + p.cx, p.fy * seen[:, 1] / seen[:, 2] + p.cy], 1)


def shots(count, **changes):
    options = dataclasses.replace(VIEW, **changes)
    return [random_shot(np.random.default_rng(seed), BOX, UP, 160, 128, options) for seed in range(count)]


def test_whole_people_fill_their_share_and_stay_inside():
    filled = []
    for shot in shots(60, half=0.0):
        points = pixels(shot, BOX)
        assert (points > 0).all()
        assert (points < [128, 160]).all()
        filled.append(max(np.ptp(points, axis=0) / [128, 160]))
    assert min(filled) == pytest.approx(VIEW.share[0], abs=0.02)
    assert max(filled) == pytest.approx(VIEW.share[1], abs=0.02)


def test_parts_of_people_fill_the_height():
    for shot in shots(30, half=1.0):
        tall = np.ptp(pixels(shot, BOX)[:, 1])
        assert 160 / VIEW.part[1] - 1 < tall < 160 / VIEW.part[0] + 1


def test_cameras_are_rotations_upright_from_all_around():
    azimuths = []
    for shot in shots(60):
        R = shot.T_cam_from_world[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        assert (R @ UP)[1] < -0.8  # up in the world is up in the picture
        assert shot.pinhole.fx == shot.pinhole.fy
        azimuths.append(np.arctan2(*(-R.T @ [0, 0, 1])[:2]))
    assert np.histogram(azimuths, 4, (-np.pi, np.pi))[0].min() > 5


def test_seed_decides():
    first, again = (random_shot(np.random.default_rng(5), BOX, UP, 96, 96, VIEW) for _ in range(2))
    assert np.array_equal(first.T_cam_from_world, again.T_cam_from_world)
    assert first.pinhole == again.pinhole
