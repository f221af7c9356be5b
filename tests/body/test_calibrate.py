"""Triangulation and camera refinement on a synthetic body whose cameras are known."""

import dataclasses

import numpy as np
import pytest
import torch

from soar.body.calibrate import CalibrateSettings, angle_between, refine_rotations
from soar.body.observations import Observations
from soar.body.openpose import COUNT, LIMBS
from soar.body.triangulate import TriangulationSettings, residuals, triangulate
from soar.config import settings
from soar.errors import CalibrationError, SubjectError
from soar.geometry.rotations import axis_angle_to_matrix
from tests.body import stickman
from tests.conftest import conf

SETTINGS = settings(CalibrateSettings, conf("calibrate", "default"))
UP = np.array([0.0, 0.0, 1.0])
LINEAR = TriangulationSettings(sigma=2.0, iterations=0)
ROBUST = TriangulationSettings(sigma=2.0, iterations=15)


def turned(camera, degrees, seed):
    """The camera turned about its centre by an angle, about a random axis."""
    axis = np.random.default_rng(seed).standard_normal(3)
    turn = torch.tensor(np.radians(degrees) * axis / np.linalg.norm(axis))
    T = np.eye(4)
    T[:3, :3] = axis_angle_to_matrix(turn).numpy()
    return dataclasses.replace(camera, T_cam_from_world=T @ camera.T_cam_from_world)


@pytest.fixture(scope="module")
def scene():
    model = stickman.body()
    return model, stickman.motion(model, 12)


def test_linear_triangulation_is_exact_without_noise():
    rng = np.random.default_rng(0)
    X = rng.uniform(-0.5, 0.5, (4, 5, 3)) + UP
    views = stickman.cameras(3)
    points = np.stack([c.project(X) for c in views])
    got = triangulate(views, points, np.ones(points.shape[:-1]), np.ones((3, 1, 1)), LINEAR)
    np.testing.assert_allclose(got, X, atol=1e-9)


def test_robust_triangulation_ignores_one_wrong_view_and_weights_by_confidence():
    rng = np.random.default_rng(1)
    X = rng.uniform(-0.5, 0.5, (20, 3)) + UP
    views = stickman.cameras(5)
    points = np.stack([c.project(X) for c in views])
    points[2] += 60
    confidence = np.ones((5, 20))
    linear = triangulate(views, points, confidence, np.full((5, 1), 4.0), LINEAR)
    robust = triangulate(views, points, confidence, np.full((5, 1), 4.0), ROBUST)
    assert np.linalg.norm(linear - X, axis=1).min() > 0.01
    assert np.linalg.norm(robust - X, axis=1).max() < 2e-3
    confidence[2] = 0
    np.testing.assert_allclose(triangulate(views, points, confidence, np.full((5, 1), 4.0), LINEAR), X, atol=1e-9)
    confidence[1:, 7] = 0
    lonely = triangulate(views, points, confidence, np.full((5, 1), 4.0), ROBUST)
    assert np.isnan(lonely[7]).all()
    assert np.isfinite(np.delete(lonely, 7, 0)).all()


def test_refinement_recovers_perturbed_rotations(scene):
    true = stickman.cameras(4)
    wrong = tuple(turned(c, d, i) for i, (c, d) in enumerate(zip(true, (0.0, 0.8, 1.0, 0.6), strict=True)))
    seen = dataclasses.replace(stickman.observe(*scene, true, noise_px=0.5), cameras=wrong)
    result = refine_rotations(seen, SETTINGS)
    assert result.applied
    assert result.after < 1.0 < 1.5 < result.before
    assert result.linear > result.after
    # A turn common to all cameras moves the body with them: only the angles between cameras are observable.
    for i in range(1, 4):
        relative = [c[i].R @ c[0].R.T for c in (true, wrong, result.cameras)]
        assert angle_between(relative[0], relative[1]) > np.radians(0.5)
        assert angle_between(relative[0], relative[2]) < np.radians(0.25)
    for before, after in zip(wrong, result.cameras, strict=True):
        np.testing.assert_allclose(before.centre, after.centre, atol=1e-9)


def test_refinement_survives_outliers(scene):
    true = stickman.cameras(4)
    wrong = tuple(turned(c, 0.7, i) for i, c in enumerate(true))
    seen = stickman.observe(*scene, true, noise_px=0.5)
    points = seen.points.copy()
    points[1, ::3, LIMBS[2]] += 150
    result = refine_rotations(dataclasses.replace(seen, cameras=wrong, points=points), SETTINGS)
    assert result.after < 1.0


def test_few_cameras_pass_through(scene):
    two = stickman.observe(*scene, stickman.cameras(2))
    result = refine_rotations(two, SETTINGS)
    assert not result.applied
    assert result.cameras == result.original == two.cameras
    assert "Fewer than 3" in result.remark
    assert result.after == result.before < 1e-6
    alone = refine_rotations(stickman.observe(*scene, stickman.cameras(1)), SETTINGS)
    assert not alone.applied
    assert np.isnan(alone.after)
    off = refine_rotations(stickman.observe(*scene, stickman.cameras(4)), dataclasses.replace(SETTINGS, enabled=False))
    assert not off.applied
    assert "switched off" in off.remark


def test_camera_without_common_points_is_named(scene):
    seen = stickman.observe(*scene, stickman.cameras(3))
    confidence = seen.confidence.copy()
    confidence[1, :, LIMBS] = 0
    with pytest.raises(CalibrationError, match="cam1 sees too little"):
        refine_rotations(dataclasses.replace(seen, confidence=confidence), SETTINGS)


def test_observations_refuse_what_cannot_be_fitted():
    views = stickman.cameras(2)
    good = np.zeros((3, COUNT, 3))
    good[..., 2] = 0.9
    world = np.zeros((3, 25, 3))
    with pytest.raises(CalibrationError, match="different numbers of frames"):
        Observations.gather(views, [good, good[:2]], [world, world[:2]], 0.3)
    with pytest.raises(SubjectError, match="no frames"):
        Observations.gather(views, [good[:0]] * 2, [world[:0]] * 2, 0.3)
    with pytest.raises(SubjectError, match="not seen well enough"):
        Observations.gather(views, [good * (1, 1, 0.2)] * 2, [world] * 2, 0.3)
    holes = good.copy()
    holes[0, 5] = np.nan
    seen = Observations.gather(views, [holes, good], [world] * 2, 0.3)
    assert seen.confidence[0, 0, 5] == 0
    assert np.isfinite(seen.points).all()


def test_box_height_is_the_longer_side_and_fills_gaps():
    views = stickman.cameras(1)
    keypoints = np.zeros((3, COUNT, 3))
    keypoints[:, :25, 0] = np.linspace(100, 150, 25)
    keypoints[:, :25, 1] = np.linspace(50, 450, 25)
    keypoints[..., 2] = 1
    keypoints[2, :, 2] = 0
    seen = Observations.gather(views, [keypoints], [np.zeros((3, 25, 3))], 0.3)
    np.testing.assert_allclose(seen.box_height(), [[400, 400, 400]])


def test_residuals_are_projected_minus_observed():
    views = stickman.cameras(1)
    X = np.array([[0.1, 0.0, 1.0]])
    np.testing.assert_allclose(residuals(views, X, views[0].project(X)[None] - (2, -3)), [[[2, -3]]], atol=1e-9)
