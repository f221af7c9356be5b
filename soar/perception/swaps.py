"""Left/right consistency of the landmarks over time.

The landmark network sometimes exchanges the sides of the arms, the legs or the head, with full confidence and for
several frames on end: it takes a front for a back. Each frame offers sixteen hypotheses: the direct or the mirrored
pass, and which of three sets of landmarks to exchange. Dynamic programming chooses one per frame by

* the other pass, which should agree,
* ears, shoulders and hips, which should face the same way,
* continuity of the image points and of their depth from frame to frame,
* a cost for each exchange, so that the network is believed when nothing speaks against it.

Limbs that cross in the image are told apart by their depth. A clip in which the sides are exchanged in most frames is
consistent in itself and cannot be noticed.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from soar.body import openpose
from soar.perception.pose import INDEX, LANDMARKS, MIRROR

SETS = {"head": slice(1, 11), "arms": slice(11, 23), "legs": slice(23, 33)}  # landmark ranges; 0 is the nose
STATES = np.array(list(itertools.product((False, True), repeat=len(SETS))))  # (8, 3), the first exchanges nothing
GIRDLES = np.array([[INDEX["left_" + part], INDEX["right_" + part]] for part in ("ear", "shoulder", "hip")])  # by set


TORSO_METRES = 0.5  # unit of the metric depth; an adult's hips to shoulders
COORDINATES = (slice(0, 2), slice(2, 3))  # image and depth, whose distances are limited and added separately


@dataclasses.dataclass(frozen=True)
class SwapSettings:
    """Weights of the dynamic programme; distances are in torso lengths."""

    agreement_weight: float
    order_weight: float
    time_weight: float
    swap_cost: float
    mirrored_cost: float
    min_girdle_width: float
    max_distance: float


def _orders() -> np.ndarray:
    result = np.tile(np.arange(len(MIRROR)), (len(STATES), 1))
    for exchanged, members in zip(STATES.T, SETS.values(), strict=True):
        result[exchanged, members] = MIRROR[members]
    return result


def _keypoint_sets() -> np.ndarray:
    """(137,) index of the set that each keypoint belongs to, -1 for those in the middle."""
    result = np.full(openpose.COUNT, -1)
    for i, members in enumerate(SETS.values()):
        names = {LANDMARKS[m].replace("foot_index", "big_toe") for m in range(members.start, members.stop)}
        result[[openpose.INDEX[name] for name in names if name in openpose.BODY]] = i
    result[[openpose.INDEX[f"{side}_small_toe"] for side in ("left", "right")]] = list(SETS).index("legs")
    result[openpose.LEFT_HAND] = result[openpose.RIGHT_HAND] = list(SETS).index("arms")
    result[openpose.FACE] = list(SETS).index("head")
    return result


_KEYPOINT_SET = _keypoint_sets()
ORDERS = _orders()  # (8, 33) permutation of the landmarks for each state


def torso(points: np.ndarray) -> np.ndarray:
    """Vector (..., D) from the middle of the hips to the middle of the shoulders of landmarks (..., 33, D)."""
    return points[..., GIRDLES[1], :].mean(-2) - points[..., GIRDLES[2], :].mean(-2)


def set_distance(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray:
    """(..., 3) mean distance of landmarks (..., 33, D) over each set; a single one counts at most ``limit``."""
    distance = np.minimum(np.linalg.norm(a - b, axis=-1), limit)
    return np.stack([distance[..., members].mean(-1) for members in SETS.values()], axis=-1)


def exchanged(points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(..., 3) bool: which sets of ``points`` (..., 33, D) are nearer to ``reference`` with its sides exchanged."""
    keep, swap = (set_distance(points, r, np.inf) for r in (reference, reference[..., ORDERS[-1], :]))
    return swap < keep


def relabelled(points: np.ndarray, sets: np.ndarray) -> np.ndarray:
    """Exchange the sides of the given ``sets`` (T, 3) bool in landmarks (T, 33, ...)."""
    states = sets @ (1 << np.arange(len(SETS))[::-1])
    return points[np.arange(len(points))[:, None], ORDERS[states]]


def exchange(keypoints: np.ndarray, sets: np.ndarray) -> np.ndarray:
    """Exchange the sides of the given ``sets`` (T, 3) bool in keypoints (T, 137, ...), hands and face included."""
    member = sets[:, _KEYPOINT_SET] & (_KEYPOINT_SET >= 0)
    order = np.where(member, openpose.mirror(), np.arange(openpose.COUNT))
    return keypoints[np.arange(len(keypoints))[:, None], order]


def viterbi(unary: np.ndarray, pairwise: np.ndarray) -> np.ndarray:
    """Cheapest sequence of states: unary (T, S), pairwise (T - 1, S, S) from state to state; returns (T,) indices."""
    cost, back = unary[0], []
    for t in range(1, len(unary)):
        total = cost[:, None] + pairwise[t - 1]
        back.append(total.argmin(0))
        cost = total.min(0) + unary[t]
    path = [int(cost.argmin())]
    for step in reversed(back):
        path.append(int(step[path[-1]]))
    return np.array(path[::-1])


def _order_cost(points: np.ndarray, min_width: float) -> np.ndarray:
    """(S,) number of neighbouring girdles of hypotheses (S, 33, 2) that clearly face opposite ways."""
    up = torso(points)
    across = np.stack([-up[:, 1], up[:, 0]], -1) / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-6)
    widths = ((points[:, GIRDLES[:, 0]] - points[:, GIRDLES[:, 1]]) * across[:, None]).sum(-1)
    clear = np.where(np.abs(widths) > min_width, np.sign(widths), 0)
    return (clear[:, 1:] * clear[:, :-1] < 0).sum(-1)


def resolve(passes: np.ndarray, depth: np.ndarray, settings: SwapSettings) -> tuple[np.ndarray, np.ndarray]:
    """Choose a hypothesis for every frame.

    Args:
        passes: (2, T, 33, 2) image landmarks in pixels of the direct and the mirrored pass (sides mapped back), of the
            frames in which the subject was found.
        depth: (2, T, 33) metres, likewise; keeps apart limbs that cross in the image.
        settings: weights.

    Returns:
        (T,) the pass to use, 0 or 1, and (T, 3) bool, the sets of it to exchange.
    """
    count = passes.shape[1]
    if not count:
        return np.zeros(0, int), np.zeros((0, len(SETS)), bool)
    length = np.linalg.norm(torso(passes[0]), axis=-1)
    # A torso seen end-on is short in the image; half the clip's usual length keeps the unit meaningful.
    unit = np.maximum(length, max(float(np.median(length)) / 2, 1.0))
    centre = passes[..., GIRDLES[1:].ravel(), :].mean(-2, keepdims=True)
    centred = (passes - centre) / unit[:, None, None]
    centred = np.concatenate([centred, depth[..., None] / TORSO_METRES], axis=-1)
    hypotheses = np.concatenate([centred[s][:, ORDERS] for s in (0, 1)], axis=1)  # (T, 16, 33, 3)
    others = np.repeat(centred[::-1].swapaxes(0, 1), len(STATES), axis=1)
    fixed = settings.swap_cost * np.tile(STATES.sum(1), 2) + settings.mirrored_cost * np.repeat([0, 1], len(STATES))
    limit = settings.max_distance
    unary = fixed + settings.agreement_weight * set_distance(hypotheses[..., :2], others[..., :2], limit).sum(-1)
    for t in range(count):
        unary[t] += settings.order_weight * _order_cost(hypotheses[t, ..., :2], settings.min_girdle_width)
    pairwise = [
        settings.time_weight * sum(set_distance(a[:, None, :, c], b[None, :, :, c], limit).sum(-1) for c in COORDINATES)
        for a, b in itertools.pairwise(hypotheses)
    ]
    best = viterbi(unary, np.array(pairwise))
    return best // len(STATES), STATES[best % len(STATES)]
