"""Left/right consistency on synthetic motion."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from soar.config import settings
from soar.perception.pose import INDEX, LANDMARKS, MIRROR
from soar.perception.swaps import (
    GIRDLES,
    ORDERS,
    SETS,
    STATES,
    SwapSettings,
    exchanged,
    relabelled,
    resolve,
    viterbi,
)
from tests.conftest import conf

OPTIONS = settings(SwapSettings, conf("keypoints", "mediapipe")["swaps"])
T = 40
HEIGHT = {
    "nose": 0, "eye": -10, "ear": -8, "mouth": 8, "shoulder": 60, "elbow": 150, "wrist": 230, "pinky": 245,
    "index": 248, "thumb": 242, "hip": 260, "knee": 400, "ankle": 540, "heel": 555, "foot": 560,
}  # fmt: skip
WIDTH = {
    "shoulder": 50,
    "elbow": 60,
    "wrist": 65,
    "pinky": 70,
    "index": 66,
    "thumb": 60,
    "ear": 20,
    "eye": 10,
    "mouth": 8,
}


def _walker(yaw: np.ndarray, stride: float = 0.0) -> np.ndarray:
    """(T, 33, 2) pixels of a person facing the camera at yaw 0 who walks with ``stride`` pixels in the side view."""
    points = np.zeros((len(yaw), 33, 2))
    for i, name in enumerate(LANDMARKS):
        part = next(p for p in ("shoulder", "elbow", "wrist", "pinky", "index", "thumb", "hip", "knee", "ankle", "heel",
                                "foot", "mouth", "ear", "eye", "nose") if p in name)  # fmt: skip
        side = 1 if "left" in name else -1 if "right" in name else 0
        swing = stride * side * np.sin(np.arange(len(yaw)) * 0.35) if part in ("knee", "ankle", "heel", "foot") else 0
        points[:, i, 0] = 500 + side * WIDTH.get(part, 30) * np.cos(yaw) + swing * np.sin(yaw) + 2 * np.arange(len(yaw))
        points[:, i, 1] = 200 + HEIGHT[part]
    return points


def _noisy(points: np.ndarray, seed: int) -> np.ndarray:
    return points + np.random.default_rng(seed).normal(0, 3, points.shape)


def _swapped(points: np.ndarray, frames: slice | list[int], name: str) -> np.ndarray:
    out, members = points.copy(), SETS[name]
    out[frames, members] = points[frames][:, MIRROR[members]]
    return out


def _solve(direct: np.ndarray, mirrored: np.ndarray, depth: np.ndarray | None = None) -> np.ndarray:
    passes = np.stack([direct, mirrored])
    source, sets = resolve(passes, np.zeros(passes.shape[:3]) if depth is None else depth, OPTIONS)
    return relabelled(passes[source, np.arange(len(source))], sets)


def _all(points: np.ndarray, frames: slice | list[int]) -> np.ndarray:
    for name in SETS:
        points = _swapped(points, frames, name)
    return points


def test_tables():
    assert not STATES[0].any()
    assert len(STATES) == 8
    assert (ORDERS[0] == np.arange(33)).all()
    assert (ORDERS[-1] == MIRROR).all()
    assert LANDMARKS[SETS["arms"].start] == "left_shoulder"
    assert LANDMARKS[SETS["legs"].start] == "left_hip"
    assert GIRDLES[2].tolist() == [INDEX["left_hip"], INDEX["right_hip"]]
    sets = np.array([[False, True, False]])
    moved = relabelled(np.arange(33)[None], sets)[0]
    assert moved[INDEX["left_elbow"]] == INDEX["right_elbow"]
    assert moved[INDEX["left_knee"]] == INDEX["left_knee"]


def test_viterbi_against_all_paths():
    rng = np.random.default_rng(0)
    unary, pairwise = rng.uniform(size=(5, 3)), rng.uniform(size=(4, 3, 3))

    def cost(path: tuple[int, ...]) -> float:
        return sum(unary[t, s] for t, s in enumerate(path)) + sum(pairwise[t][path[t], path[t + 1]] for t in range(4))

    assert tuple(viterbi(unary, pairwise)) == min(itertools.product(range(3), repeat=5), key=cost)


def test_clean_motion_is_left_alone():
    truth = _walker(np.full(T, 0.2))
    direct = _noisy(truth, 0)
    source, sets = resolve(np.stack([direct, _noisy(truth, 1)]), np.zeros((2, T, 33)), OPTIONS)
    assert not sets.any()
    assert not exchanged(_solve(direct, _noisy(truth, 1)), truth).any()
    assert (source == 0).mean() > 0.5


@pytest.mark.parametrize("name", ["arms", "legs"])
def test_a_short_exchange_of_one_set_in_both_passes(name):
    truth = _walker(np.full(T, 0.2))
    direct, mirrored = (_swapped(_noisy(truth, i), slice(15, 19), name) for i in (0, 1))
    assert exchanged(direct, truth)[16].any()
    assert not exchanged(_solve(direct, mirrored), truth).any()


def test_an_exchange_of_everything_in_the_direct_pass_prefers_the_mirrored_one():
    truth, wrong = _walker(np.full(T, 0.2)), [3, 7, 8, 20, 25, 30]
    direct, mirrored = _all(_noisy(truth, 0), wrong), _noisy(truth, 1)
    source, sets = resolve(np.stack([direct, mirrored]), np.zeros((2, T, 33)), OPTIONS)
    assert source[wrong].mean() > 0.5
    assert (sets.any(1) == ((source == 0) & np.isin(np.arange(T), wrong))).all()
    assert not exchanged(_solve(direct, mirrored), truth).any()


def test_a_run_of_exchanges_in_both_passes():
    truth = _walker(np.full(T, 0.2))
    direct, mirrored = _all(_noisy(truth, 0), slice(20, 30)), _all(_noisy(truth, 1), slice(21, 29))
    assert not exchanged(_solve(direct, mirrored), truth).any()


def test_legs_that_cross_in_profile_keep_their_names():
    truth = _walker(np.full(T, np.pi / 2), stride=60)
    solved = _solve(_noisy(truth, 0), _noisy(truth, 1))
    apart = np.abs(truth[:, INDEX["left_ankle"], 0] - truth[:, INDEX["right_ankle"], 0]) > 30
    assert apart.sum() > 10
    assert not exchanged(solved, truth)[apart, list(SETS).index("legs")].any()


def test_fast_crossing_limbs_are_told_apart_by_depth():
    truth = _walker(np.full(T, np.pi / 2), stride=110)[::5]
    depth = np.zeros((2, len(truth), 33))
    depth[:, :, 11:33] = np.where(np.arange(11, 33) % 2, -0.15, 0.15)  # odd landmarks are the left, nearer ones
    ankles = truth[:, INDEX["left_ankle"], 0] - truth[:, INDEX["right_ankle"], 0]
    assert (np.diff(np.sign(ankles)) != 0).sum() >= 3
    solved = _solve(_noisy(truth, 0), _noisy(truth, 1), depth)
    assert not exchanged(solved, truth)[:, list(SETS).index("legs")].any()


def test_a_person_who_turns_round_keeps_their_sides():
    truth = _walker(np.linspace(0, np.pi, T))
    solved = _solve(_noisy(truth, 0), _noisy(truth, 1))
    sideways = np.arange(T // 2 - 3, T // 2 + 3)
    facing = np.setdiff1d(np.arange(T), sideways)
    assert not exchanged(solved, truth)[facing, 1:].any()


def test_shoulders_and_hips_facing_opposite_ways_in_a_single_frame():
    truth = _walker(np.zeros(1))
    direct = _swapped(truth, [0], "arms")
    solved = _solve(direct, direct)
    widths = [solved[0, a, 0] - solved[0, b, 0] for a, b in GIRDLES[1:]]
    assert widths[0] * widths[1] > 0


def test_no_frames():
    source, sets = resolve(np.zeros((2, 0, 33, 2)), np.zeros((2, 0, 33)), OPTIONS)
    assert source.shape == (0,)
    assert sets.shape == (0, 3)
