"""Poses and motions: joint limits read off the posed skeleton, feet on the ground, limbs outside the body."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from soar.body import lbs
from soar.errors import ConfigError
from soar.geometry.rotations import axis_angle_to_matrix
from soar.synthetic import motions, poses
from soar.synthetic.mannequin import LIMITS, NEUTRAL
from soar.synthetic.motions import draw_motion
from soar.synthetic.poses import draw_pose
from soar.synthetic.scene import People
from tests.synthetic.conftest import SETTINGS


def _joints(people: People, betas: np.ndarray, pose: np.ndarray) -> dict[str, np.ndarray]:
    """World positions (T, 3) of the joints by name, by the body floor's own chain."""
    body = people.wardrobe.body
    b = torch.as_tensor(betas)
    A = lbs.joint_transforms(body, b, axis_angle_to_matrix(torch.from_numpy(pose)))
    rest = lbs.rest_joints(body, b)
    points = (A[..., :3] @ rest[..., None]).squeeze(-1) + A[..., 3]
    return {name: points[:, i].numpy() for i, name in enumerate(body.joint_names)}


def _bend(j: dict[str, np.ndarray], a: str, b: str, c: str) -> np.ndarray:
    u, v = j[b] - j[a], j[c] - j[b]
    cosine = (u * v).sum(-1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(v, axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _check(j: dict[str, np.ndarray]) -> None:
    for s in "LR":
        elbow = _bend(j, f"upperarm01.{s}", f"lowerarm01.{s}", f"wrist.{s}")
        knee = _bend(j, f"upperleg01.{s}", f"lowerleg01.{s}", f"foot.{s}")
        assert (elbow < 148).all()
        assert (knee < 140).all()
        thigh, shin = j[f"lowerleg01.{s}"] - j[f"upperleg01.{s}"], j[f"foot.{s}"] - j[f"lowerleg01.{s}"]
        across = j["upperleg01.L"] - j["upperleg01.R"]
        bent = knee > 12
        # Knees bend backwards: thigh x shin points to the left. Elbows never bend past straight (about 3 degrees).
        assert ((np.cross(thigh, shin) * across).sum(-1)[bent] > 0).all()
        assert (elbow > 1).all()
    head = j["head"] - j["neck01"]
    assert (head[:, 2] / np.linalg.norm(head, axis=-1) > 0.3).all()


def test_drawn_poses_keep_to_the_limits_and_out_of_the_body(people: People) -> None:
    kinds, pressed, grounds = [], [], []
    for seed in range(40):
        subject = people.subject("train", seed)
        mannequin = people.mannequin(subject)
        pose = people.pose(subject)
        _check(_joints(people, subject.betas, pose.pose[None]))
        rotations = axis_angle_to_matrix(torch.from_numpy(pose.pose[None])).double().numpy()
        points, normals = mannequin.skinned(rotations)
        kinds.append(pose.kind)
        pressed.append(mannequin.contact(points, normals)[0])
        grounds.append((points[0, :, 2] + pose.translation[2]).min() - mannequin.ground)
    assert len(set(kinds)) == len(SETTINGS.pose.weights)
    assert np.mean(np.array(pressed) < SETTINGS.pose.clearance + 1e-3) > 0.95
    assert max(pressed) < 0.04
    np.testing.assert_allclose(grounds, 0, atol=0.02)


def test_poses_are_deterministic_and_takes_differ(people: People) -> None:
    subject = people.subject("benchmark", 3)
    one, again, other = people.pose(subject), people.pose(subject), people.pose(subject, 1)
    np.testing.assert_array_equal(one.pose, again.pose)
    assert np.abs(one.pose - other.pose).max() > 0.05


def test_angles_do_what_their_names_say(people: People) -> None:
    subject = dataclasses.replace(people.subject("train", 0), betas=np.zeros(10, np.float32))
    mannequin = people.mannequin(subject)

    def joints(**angles: float) -> dict[str, np.ndarray]:
        return _joints(people, subject.betas, mannequin.axis_angles(mannequin.rotations({**NEUTRAL, **angles})))

    neutral = joints()
    level = joints(l_raise=90, l_plane=0, l_elbow=3)
    assert level["wrist.L"][0, 0] > 0.55
    assert abs(level["lowerarm01.L"][0, 2] - level["upperarm01.L"][0, 2]) < 0.08
    assert joints(r_raise=90, r_plane=90, r_elbow=3)["wrist.R"][0, 1] < -0.4
    assert joints(l_raise=170)["wrist.L"][0, 2] > neutral["head"][0, 2]
    assert joints(l_hip=60)["lowerleg01.L"][0, 1] < neutral["lowerleg01.L"][0, 1] - 0.25
    assert joints(l_knee=90)["foot.L"][0, 1] > neutral["foot.L"][0, 1] + 0.3
    assert joints(l_abduct=30)["foot.L"][0, 0] > neutral["foot.L"][0, 0] + 0.3
    assert joints(bend=40)["head"][0, 1] < neutral["head"][0, 1] - 0.2
    assert joints(turn=50)["eye.L"][0, 1] > joints(turn=-50)["eye.L"][0, 1]
    fist = joints(l_curl=80)
    assert np.linalg.norm(fist["finger3-3.L"] - fist["wrist.L"]) < np.linalg.norm(
        neutral["finger3-3.L"] - neutral["wrist.L"]
    )
    np.testing.assert_allclose(_bend(joints(l_elbow=70), "upperarm01.L", "lowerarm01.L", "wrist.L"), 70, atol=0.5)
    assert set(NEUTRAL) == set(LIMITS)
    assert all(low <= NEUTRAL[name] <= high for name, (low, high) in LIMITS.items())


@pytest.mark.parametrize("kind", list(motions.KINDS))
def test_motions_are_smooth_within_limits_and_on_the_ground(people: People, kind: str) -> None:
    subject = people.subject("train", 5)
    motion = people.motion(subject, kind)
    times = np.arange(0, motion.duration, 1 / 30)
    body_motion = motion.body_motion(times, subject.betas)
    assert len(body_motion) == len(times)
    pose, translation = body_motion.pose.numpy(), body_motion.translation.numpy()
    joints = _joints(people, subject.betas, pose)
    local = pose.copy()
    local[:, 0] = 0
    _check(_joints(people, subject.betas, local))
    steps = [np.linalg.norm(np.diff(p + translation, axis=0), axis=-1).max() for p in joints.values()]
    assert max(steps) < 0.15  # metres in a thirtieth of a second
    assert np.abs(np.diff(translation, axis=0)).max() < 0.08
    mannequin = people.mannequin(subject)
    points, normals = mannequin.skinned(mannequin.rotations(motion.state(times)[0]))
    np.testing.assert_allclose((points[:, :, 2] + translation[:, 2:]).min(1), mannequin.ground, atol=0.02)
    assert mannequin.contact(points, normals).max() < SETTINGS.pose.clearance + 0.01
    if kind == "walk":
        assert np.linalg.norm(translation[-1, :2] - translation[0, :2]) > 1.0
        feet = np.stack([joints[f"foot.{s}"][:, :2] + translation[:, :2] for s in "LR"])
        slowest = np.linalg.norm(np.diff(feet, axis=1), axis=-1).min(0)
        assert np.median(slowest) < 0.5 * np.median(np.linalg.norm(np.diff(translation[:, :2], axis=0), axis=-1))
    if kind == "turn":
        facing = joints["eye.L"][:, :2] - joints["eye.R"][:, :2]
        angle = np.unwrap(np.arctan2(facing[:, 1], facing[:, 0]))
        assert abs(angle[-1] - angle[0]) > 1.8 * np.pi


def test_unknown_kinds_are_named(people: People) -> None:
    mannequin = people.mannequin(people.subject("train", 0))
    rng = np.random.default_rng(0)
    with pytest.raises(ConfigError, match="kind of pose"):
        draw_pose(mannequin, rng, dataclasses.replace(SETTINGS.pose, weights={"swim": 1.0}))
    with pytest.raises(ConfigError, match="kind of motion"):
        draw_motion("swim", mannequin, rng, 0.01)
    assert set(SETTINGS.pose.weights) == set(poses.KINDS)
