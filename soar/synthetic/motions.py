"""Short motions as functions of time: walk, turn, reach, dance. They are smooth: any frame rate may sample them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch

from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT
from soar.errors import ConfigError
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from soar.synthetic.mannequin import NEUTRAL, Mannequin
from soar.synthetic.poses import walk_angles

_State = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]
"""Angles (T,) by name, heading (T,) radians to the left of -y, and place (T, 2) metres on the ground."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """A motion of one mannequin.

    Attributes:
        kind: name in :data:`KINDS`.
        duration: seconds after which it has shown everything; it goes on smoothly beyond.
        state: angles, heading and place at times (T,).
    """

    kind: str
    duration: float
    mannequin: Mannequin
    state: Callable[[np.ndarray], _State]

    def sample(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axis-angle (T, J, 3) radians and translation (T, 3) metres, float32, at ``times`` (T,) seconds."""
        angles, heading, place = self.state(np.asarray(times, float))
        rotations = self.mannequin.rotations(angles)
        translation = self.mannequin.standing(self.mannequin.skinned(rotations)[0]).astype(np.float64)
        pose = self.mannequin.axis_angles(rotations)
        about_up = torch.zeros(len(heading), 3, dtype=torch.float64)
        about_up[:, 2] = torch.from_numpy(np.broadcast_to(heading, (len(translation),)).copy())
        pose[:, 0] = matrix_to_axis_angle(axis_angle_to_matrix(about_up)).numpy()
        translation[:, :2] += place
        return pose, translation.astype(np.float32)

    def body_motion(self, times: np.ndarray, betas: np.ndarray) -> BodyMotion:
        """The same as the artifact of the stage ``body``."""
        pose, translation = self.sample(times)
        return BodyMotion(
            torch.from_numpy(np.asarray(betas, np.float32)), torch.from_numpy(pose), torch.from_numpy(translation),
            torch.zeros(COUNT, 3),
        )  # fmt: skip


def _walk(rng: np.random.Generator, mannequin: Mannequin) -> tuple[float, Callable[[np.ndarray], _State]]:
    stride, swing, rate = rng.uniform(0.7, 1.1), rng.uniform(0.6, 1.2), rng.uniform(0.75, 1.0)
    start, curve = rng.uniform(0, 2 * np.pi), rng.uniform(-0.25, 0.25)
    leg = float(mannequin.joints[:, 2].max() - mannequin.ground) * 0.5
    speed = 4 * leg * np.sin(np.radians(24 * stride)) * rate  # two steps a cycle, each from hip to hip

    def state(t: np.ndarray) -> _State:
        heading = curve * t
        # The path of constant speed and curvature.
        if abs(curve) < 1e-3:
            place = np.stack([0 * t, -speed * t], -1)
        else:
            place = speed / curve * np.stack([1 - np.cos(heading), -np.sin(heading)], -1)
        return walk_angles(2 * np.pi * rate * t + start, stride, swing), heading, place

    return 3.0 / rate, state


def _turn(rng: np.random.Generator, mannequin: Mannequin) -> tuple[float, Callable[[np.ndarray], _State]]:
    way, rate = rng.choice([-1.0, 1.0]), rng.uniform(0.7, 1.0)
    seconds = rng.uniform(4.0, 7.0)  # of a whole turn

    def state(t: np.ndarray) -> _State:
        angles = walk_angles(2 * np.pi * rate * t, 0.28, 0.35)  # small steps on the spot
        angles["turn"] = angles["turn"] + way * 14
        return angles, way * 2 * np.pi * t / seconds, np.zeros((len(t), 2))

    return seconds, state


def _waves(
    rng: np.random.Generator, centre: dict[str, float], extent: dict[str, float], beat: float
) -> Callable[[np.ndarray], dict[str, np.ndarray]]:
    """Every named angle swings about its centre in a mix of the beat and its double."""
    phase = {name: rng.uniform(0, 2 * np.pi, 2) for name in extent}
    share = {name: rng.uniform(0.55, 0.9) for name in extent}

    def angles(t: np.ndarray) -> dict[str, np.ndarray]:
        out = {name: np.full(len(t), value) for name, value in {**NEUTRAL, **centre}.items()}
        for name, size in extent.items():
            slow, fast = (np.sin(2 * np.pi * beat * k * t + phase[name][k - 1]) for k in (1, 2))
            out[name] = out[name] + size * (share[name] * slow + (1 - share[name]) * fast)
        return out

    return angles


def _reach(rng: np.random.Generator, mannequin: Mannequin) -> tuple[float, Callable[[np.ndarray], _State]]:
    first = rng.permutation(["l", "r"])
    goal = {s: {"raise": rng.uniform(70, 150), "plane": rng.uniform(20, 85), "elbow": rng.uniform(8, 35)} for s in "lr"}
    idle = _waves(rng, {}, {"side": 1.5, "turn": 4.0, "nod": 2.0}, 0.25)

    def state(t: np.ndarray) -> _State:
        angles = idle(t)
        for order, side in enumerate(first):
            # Out, hold, back; the second arm follows two seconds later.
            x = np.mod(t - 2.0 * order, 4.0) / 4.0
            out = np.clip(np.minimum(x / 0.28, (0.62 - x) / 0.28), 0, 1)
            out = out * out * (3 - 2 * out)
            for name, value in goal[side].items():
                key = f"{side}_{name}"
                angles[key] = angles[key] + out * (value - angles[key])
            sign = 1 if side == "l" else -1
            angles["twist"] = angles["twist"] - sign * 12 * out
            angles["bend"] = angles["bend"] + 6 * out
        return angles, np.zeros(len(t)), np.zeros((len(t), 2))

    return 4.0, state


def _dance(rng: np.random.Generator, mannequin: Mannequin) -> tuple[float, Callable[[np.ndarray], _State]]:
    beat = rng.uniform(0.35, 0.6)
    centre = {
        **{f"{s}_{n}": rng.uniform(*span) for s in "lr" for n, span in {
            "raise": (50, 100), "plane": (5, 60), "elbow": (35, 80), "hip": (12, 20), "knee": (18, 30),
            "abduct": (4, 12),
            "out": (4, 14), "roll": (-20, 20)}.items()},
    }  # fmt: skip
    extent = {
        **{f"{s}_{n}": rng.uniform(*span) for s in "lr" for n, span in {
            "raise": (15, 35), "plane": (10, 25), "elbow": (15, 30), "hip": (4, 11), "knee": (6, 16), "roll": (5, 25),
            "palm": (5, 20)}.items()},
        "twist": 12.0, "side": 7.0, "turn": 12.0, "tilt": 5.0, "nod": 4.0,
    }  # fmt: skip
    angles, sway = _waves(rng, centre, extent, beat), rng.uniform(0.03, 0.08)
    way = rng.uniform(-0.5, 0.5)

    def state(t: np.ndarray) -> _State:
        side = sway * np.sin(2 * np.pi * beat * t)
        return angles(t), way * np.sin(np.pi * beat * t), np.stack([side, 0 * side], -1)

    return 2.0 / beat, state


KINDS: dict[str, Callable[[np.random.Generator, Mannequin], tuple[float, Callable[[np.ndarray], _State]]]] = {
    "walk": _walk, "turn": _turn, "reach": _reach, "dance": _dance,
}  # fmt: skip

_TRIES = 24


def draw_motion(kind: str, mannequin: Mannequin, rng: np.random.Generator, clearance: float) -> Motion:
    """A motion of this kind in which limbs stay out of the body; of 24 draws the one with least contact at worst.

    Args:
        kind: name in :data:`KINDS`.
        mannequin: who moves.
        rng: the randomness.
        clearance: how deep limbs may press into each other, metres.

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError("unknown kind of motion", expected=", ".join(KINDS), got=kind)
    best, least = [], np.inf
    for _ in range(_TRIES):
        duration, state = KINDS[kind](rng, mannequin)
        motion = Motion(kind, duration, mannequin, state)
        rotations = mannequin.rotations(motion.state(np.linspace(0, motion.duration, 24))[0])
        deepest = float(mannequin.contact(*mannequin.skinned(rotations)).max())
        if deepest < least:
            best, least = [motion], deepest
        if least < clearance:
            break
    return best[0]
