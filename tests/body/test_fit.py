"""The fit recovers known motions from projected keypoints and outlines, from several cameras and from one."""

import dataclasses

import cv2
import numpy as np
import pytest
import torch

from soar.body import measure
from soar.body.calibrate import angle_between
from soar.body.fit import FitSettings, Objective, fit_body
from soar.body.initial import Poses, points_from_world, pose_from_points, torso_frames
from soar.body.openpose import COUNT, INDEX
from soar.body.robust import geman_mcclure, minimise
from soar.body.silhouette import Silhouettes, largest, trace
from soar.body.skeleton import collapse
from soar.body.triangulate import triangulate
from soar.config import settings
from soar.errors import ConfigError, NumericalError, SubjectError
from soar.geometry.rotations import axis_angle_to_matrix
from tests.body import stickman
from tests.conftest import conf

CPU = settings(FitSettings, conf("body", "cpu"))
NO_MASKS = dataclasses.replace(
    CPU,
    silhouette=dataclasses.replace(CPU.silhouette, weight=0.0),
    weights=dataclasses.replace(CPU.weights, shape=0.005, camera=0.0),
    offsets=False,
    iterations=60,
)


@pytest.fixture(scope="module")
def model():
    return stickman.body()


@pytest.fixture(scope="module")
def motion(model):
    return stickman.motion(model)


def start_of(model, seen, options):
    unit = (seen.box_height() / 100)[..., None]
    points = triangulate(seen.cameras, seen.points, seen.confidence, unit, options.triangulation)
    return pose_from_points(model, collapse(model), points, options.initial)


def error_cm(model, fitted, motion):
    valid = model.keypoint_valid.numpy()
    a, b = (measure.motion_keypoints(model, m)[:, valid] for m in (doubled(fitted), motion))
    return 100 * np.linalg.norm(a - b, axis=-1)


def doubled(motion):
    return dataclasses.replace(motion, **{f.name: getattr(motion, f.name).double() for f in dataclasses.fields(motion)})


def with_weights(options, **weights):
    return dataclasses.replace(options, weights=dataclasses.replace(options.weights, **weights))


def test_torso_frame_is_the_root_rotation(model, motion):
    keypoints = measure.motion_keypoints(
        model, dataclasses.replace(motion, pose=motion.pose * torch.eye(len(model.joint_names))[0][:, None])
    )
    got = torso_frames(model, keypoints)
    expected = motion.rotations[:, 0].numpy()
    assert np.abs(got - expected).max() < 1e-6
    with pytest.raises(SubjectError, match="never all seen"):
        torso_frames(model, np.where(np.arange(COUNT)[:, None] == INDEX["left_hip"], np.nan, keypoints))


def test_recovers_motion_from_three_cameras(model, motion):
    seen = stickman.observe(model, motion, stickman.cameras(3))
    found = fit_body(model, seen, start_of(model, seen, NO_MASKS), with_weights(NO_MASKS, smooth=0.01, pose=1e-4))
    assert set(found.history[-1]) == {"data", "smooth", "pose", "shape"}
    assert np.median(error_cm(model, found.motion, motion)) < 0.4
    assert abs(float(found.motion.betas[0] - motion.betas[0])) < 0.15
    error = measure.reprojection(seen, measure.motion_keypoints(model, doubled(found.motion)))
    assert np.nanmedian(error) < 0.6


def test_recovers_motion_despite_outliers_and_gaps(model, motion):
    seen = stickman.observe(model, motion, stickman.cameras(4), noise_px=0.5)
    points, confidence = seen.points.copy(), seen.confidence.copy()
    points[2, 1:3, INDEX["left_wrist"]] += 200
    confidence[0, 3] = 0
    confidence[1:, 4, INDEX["right_knee"]] = 0
    seen = dataclasses.replace(seen, points=points, confidence=confidence)
    found = fit_body(model, seen, start_of(model, seen, NO_MASKS), with_weights(NO_MASKS, smooth=0.1, pose=1e-4))
    assert np.quantile(error_cm(model, found.motion, motion), 0.9) < 3.0


def test_recovers_pose_from_one_camera_up_to_depth(model, motion):
    """Metric landmarks of the right size and the stature make a single camera enough, up to its own blind direction."""
    seen = stickman.observe(model, motion, stickman.cameras(1))
    (camera,) = seen.cameras
    placed = points_from_world(camera, seen)
    truth = measure.motion_keypoints(model, motion)
    np.testing.assert_allclose(placed[:, INDEX["left_knee"]], truth[:, INDEX["left_knee"]], atol=1e-6)
    assert np.isnan(placed[:, 25:]).all()
    start = pose_from_points(model, collapse(model), placed, NO_MASKS.initial)
    options = with_weights(NO_MASKS, world=0.1, smooth=0.01, pose=1e-4, acceleration=1e-3)
    mean, slope = (x.double() for x in (measure.lbs.height(model)))
    found = fit_body(model, seen, start, options, stature=float(mean + slope @ motion.betas))
    assert {"world", "stature", "acceleration"} <= set(found.history[-1])
    assert np.median(error_cm(model, found.motion, motion)) < 1.5
    assert measure.stature(model, found.motion.betas.double()) == pytest.approx(
        float(mean + slope @ motion.betas), abs=0.01
    )


def test_second_differences_still_the_depth_of_one_camera_and_not_its_motion(model, motion):
    seen = stickman.observe(model, motion, stickman.cameras(1), noise_px=2.0)
    start = pose_from_points(model, collapse(model), points_from_world(seen.cameras[0], seen), NO_MASKS.initial)
    wanted = measure.jitter(measure.motion_keypoints(model, motion)[:, :25])
    found = {}
    for weight in (0.0, 0.05):
        options = with_weights(NO_MASKS, world=0.1, smooth=0.01, pose=1e-4, acceleration=weight)
        points = measure.motion_keypoints(model, doubled(fit_body(model, seen, start, options).motion))[:, :25]
        span = np.nanmax(np.ptp(points, axis=0))
        found[weight] = measure.jitter(points), span
    assert found[0.0][0] > 1.5 * wanted
    assert found[0.05][0] < 0.75 * found[0.0][0]
    assert found[0.05][1] > 0.9 * np.nanmax(np.ptp(measure.motion_keypoints(model, motion)[:, :25], axis=0))


def test_silhouettes_recover_a_shape_that_keypoints_do_not_show(model, motion):
    """Keypoints on the midline and offsets hide the width; the outline shows it."""
    views = stickman.cameras(4)
    wide = dataclasses.replace(
        motion,
        betas=torch.tensor([0.0, 1.0], dtype=torch.float64),
        pose=motion.pose[:2],
        translation=motion.translation[:2],
    )
    seen = stickman.observe(model, wide, views)
    masks = [
        [255 * measure.body_mask(c, measure.frame_vertices(model, wide, t), model).astype(np.uint8) for t in range(2)]
        for c in views
    ]
    thin = Poses(
        torch.zeros(2, dtype=torch.float64), wide.rotations[:, collapse(model).active], wide.translation,
        torch.zeros(COUNT, 3, dtype=torch.float64),
    )  # fmt: skip
    few = dataclasses.replace(CPU, groups=dict.fromkeys(CPU.groups, 1e-06), offsets=False, epochs=0)
    few = with_weights(few, camera=0.0)
    few = dataclasses.replace(
        few, silhouette=dataclasses.replace(few.silhouette, scale=1.0, rounds=2, clothing_weight=0.0)
    )

    def overlap(m):
        pairs = zip(views, masks, strict=True)
        return np.mean([measure.mask_overlap(model, m, c, stack, range(2), 0.5) for c, stack in pairs])

    before = overlap(dataclasses.replace(wide, betas=thin.betas))
    found = fit_body(model, seen, thin, few, silhouettes=Silhouettes(views, masks, few.silhouette))
    assert found.history[-1]["silhouette"] < 0.02 * few.silhouette.weight
    assert before < 0.93
    assert overlap(doubled(found.motion)) > 0.96
    assert abs(float(found.motion.betas[1]) - 1) < 0.25


def test_clothing_explains_an_outline_that_the_body_does_not(model, motion):
    """A coat of 2 cm all over: the fit that may put it down to clothing keeps shape and pose."""
    views = stickman.cameras(4)
    seen = stickman.observe(model, motion, views)
    masks = []
    for c in views:
        grown = round(0.02 * c.K[0, 0] / np.linalg.norm(c.centre))
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grown + 1, 2 * grown + 1))
        bodies = (measure.body_mask(c, measure.frame_vertices(model, motion, t), model) for t in range(len(motion)))
        masks.append([cv2.dilate(255 * body.astype(np.uint8), disk) for body in bodies])
    outlines = dataclasses.replace(CPU.silhouette, scale=1.0, stride=8, rounds=2, iterations=15, clothing_nodes=60)
    start = start_of(model, seen, NO_MASKS)

    def shape_error(weight):
        silhouette = dataclasses.replace(outlines, clothing_weight=weight)
        options = dataclasses.replace(CPU, silhouette=silhouette, iterations=60)
        found = fit_body(model, seen, start, options, silhouettes=Silhouettes(views, masks, silhouette))
        assert ("clothing" in found.history[-1]) == (weight > 0)
        return float((found.motion.betas - motion.betas).norm()), found.history[-1]["silhouette"]

    (bare, unexplained), (clothed, explained) = shape_error(0.0), shape_error(0.1)
    assert explained < 0.5 * unexplained
    assert clothed < 0.7 * bare


def test_turned_cameras_are_found(model, motion):
    """One of four cameras is half a degree off: its turn is found, the others stay."""
    views = stickman.cameras(4)
    seen = stickman.observe(model, motion, views)
    off = np.radians(0.5) * np.array([0.0, 1.0, 0.0])
    wrong = (views[0].turned(axis_angle_to_matrix(torch.from_numpy(off)).numpy()), *views[1:])
    seen = dataclasses.replace(seen, cameras=wrong)
    start = start_of(model, seen, NO_MASKS)
    options = with_weights(NO_MASKS, camera=1.0)
    found = fit_body(model, seen, start, options)
    errors = [np.degrees(angle_between(a.R, b.R)) for a, b in zip(found.cameras, views, strict=True)]
    assert errors[0] < 0.25
    assert max(errors[1:]) < 0.25
    held = fit_body(model, seen, start, with_weights(NO_MASKS, camera=0.0))
    assert held.cameras == wrong
    assert np.median(error_cm(model, found.motion, motion)) < np.median(error_cm(model, held.motion, motion))


def test_offsets_absorb_a_constant_bias_of_a_keypoint(model, motion):
    seen = stickman.observe(model, motion, stickman.cameras(3))
    shift = np.array([0.0, 0.0, 0.03])
    biased = dataclasses.replace(motion, keypoint_offsets=torch.zeros(COUNT, 3, dtype=torch.float64))
    biased.keypoint_offsets[INDEX["left_ankle"]] = torch.tensor(shift)
    truth = measure.motion_keypoints(model, biased)
    points = np.stack([c.project(np.nan_to_num(truth)) for c in seen.cameras])
    seen = dataclasses.replace(seen, points=points)
    start = start_of(model, seen, NO_MASKS)
    options = with_weights(dataclasses.replace(NO_MASKS, offsets=True), smooth=0.01, pose=1e-4, offset=0.01)
    found = fit_body(model, seen, start, options)
    size = torch.linalg.norm(found.motion.keypoint_offsets, dim=1)
    assert int(size.argmax()) == INDEX["left_ankle"]
    off = fit_body(model, seen, start, dataclasses.replace(options, offsets=False)).motion
    assert not off.keypoint_offsets.any()
    both = [
        np.nanmedian(measure.reprojection(seen, measure.motion_keypoints(model, doubled(m))))
        for m in (found.motion, off)
    ]
    assert both[0] < both[1]


def test_paper_preset_keeps_the_start_and_smooths(model, motion):
    paper = settings(FitSettings, conf("body", "paper"))
    assert (paper.weights.data, paper.weights.smooth, paper.weights.preserve, paper.epochs) == (100, 10000, 60, 40)
    seen = stickman.observe(model, motion, stickman.cameras(3), noise_px=2.0)
    start = start_of(model, seen, paper)
    short = dataclasses.replace(paper, epochs=2)
    found = fit_body(model, seen, start, short)
    assert set(found.history[-1]) == {"data", "smooth", "preserve"}
    loose = fit_body(model, seen, start, with_weights(short, smooth=0.0)).motion

    def turning(m):
        R = m.rotations
        return float(((R[1:] - R[:-1]) ** 2).sum())

    assert turning(found.motion) < 0.7 * turning(loose)
    assert np.median(error_cm(model, found.motion, motion)) < 3.0


def test_nan_names_the_term(model, motion):
    seen = stickman.observe(model, motion, stickman.cameras(3))
    start = start_of(model, seen, NO_MASKS)
    bad = dataclasses.replace(start, translation=start.translation * float("nan"))
    with pytest.raises(NumericalError, match="data"):
        fit_body(model, seen, bad, NO_MASKS)


def test_minimise_keeps_the_last_finite_state():
    x = torch.tensor([1.0], requires_grad=True)
    calls = 0

    def terms():
        nonlocal calls
        calls += 1
        return {"good": ((x - 3) ** 2).sum(), "bad": (x * float("inf" if calls > 3 else 0)).sum()}

    with pytest.raises(NumericalError, match="bad"):
        minimise(terms, [x], steps=3, iterations=5, what="a test")
    assert torch.isfinite(x).all()


def test_groups_must_be_named():
    with pytest.raises(ConfigError, match="groups"):
        settings(FitSettings, {**conf("body", "cpu"), "groups": {"limbs": 1.0}})


def test_objective_gradients(model, motion):
    """Every term but the matching, in float64, against finite differences."""
    seen = stickman.observe(model, motion, stickman.cameras(2)).select(["cam0"])
    short = dataclasses.replace(
        seen, points=seen.points[:, :3] + 3.0, confidence=seen.confidence[:, :3], world=seen.world[:, :3] + 0.02
    )
    skeleton = collapse(model)
    zero = torch.zeros(COUNT, 3, dtype=torch.float64)
    start = Poses(motion.betas, motion.rotations[:3, skeleton.active], motion.translation[:3], zero)
    options = dataclasses.replace(
        CPU, weights=dataclasses.replace(CPU.weights, world=0.1, acceleration=0.1, preserve=1.0)
    )
    objective = Objective(model, skeleton, short, start, options, stature=1.7)
    leaves = objective.parameters
    generator = torch.Generator().manual_seed(0)
    for leaf in leaves:
        leaf.data.copy_(0.1 * torch.randn(leaf.shape, generator=generator, dtype=leaf.dtype))
    total = torch.stack(list(objective.terms().values())).sum()
    gradients = torch.autograd.grad(total, leaves)
    for leaf, gradient in zip(leaves, gradients, strict=True):
        direction = torch.randn(leaf.shape, generator=generator, dtype=leaf.dtype)
        values = []
        for step in (1e-5, -2e-5):
            leaf.data.add_(step * direction)
            values.append(torch.stack(list(objective.terms().values())).sum().item())
        leaf.data.add_(1e-5 * direction)
        slope = (values[0] - values[1]) / 2e-5
        assert slope == pytest.approx(float((gradient * direction).sum()), rel=1e-4, abs=1e-7)


def test_geman_mcclure_limits():
    square = torch.tensor([0.0, 1e-6, 1e12], dtype=torch.float64)
    torch.testing.assert_close(
        geman_mcclure(square, 2.0), torch.tensor([0.0, 1e-6, 4.0], dtype=torch.float64), rtol=1e-5, atol=1e-9
    )


def test_trace_and_largest():
    image = np.zeros((60, 80), bool)
    image[20:40, 30:60] = True
    image[5, 5] = True
    assert np.count_nonzero(largest(image)) == 600
    points, normals, at = trace(largest(image), 0.5, (10, 0), (200, 200))
    assert len(points) == 2 * (20 + 30) - 4
    assert image[at].all()
    left = np.abs(points[:, 0] - (30 + 10 + 0.5) / 0.5) < 1e-9
    middle = left & (np.abs(points[:, 1] / 2 - 30) < 3)
    assert (normals[middle] @ np.array([-1.0, 0])).min() > 0.99
    cut, _, _ = trace(np.ones((50, 50), bool), 1.0, (0, 0), (50, 50))
    assert len(cut) == 0


def test_measures():
    a = np.random.default_rng(0).standard_normal((4, 9, 3))
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    assert measure.procrustes_error(1.7 * a @ turn + 3, a).max() < 1e-9
    np.testing.assert_allclose(measure.aligned_error(a + 5, a, 2), 0, atol=1e-12)
    t = np.arange(5.0)[:, None, None]
    assert measure.jitter(np.broadcast_to(t, (5, 2, 3))) == pytest.approx(0)
    assert measure.jitter(0.01 * t**2 * np.array([1.0, 0, 0])) == pytest.approx(2.0)
    assert np.isnan(measure.jitter(np.zeros((2, 3, 3))))
    half = np.zeros((4, 4), bool)
    half[:2] = True
    assert measure.overlap(half, np.ones((4, 4), bool)) == 0.5
    assert np.isnan(measure.overlap(~half & half, ~half & half))
