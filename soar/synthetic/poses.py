"""Natural poses: kinds of posture as ranges of angles, drawn within joint limits and without limbs inside the body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from soar.errors import ConfigError
from soar.synthetic.mannequin import NEUTRAL, Mannequin, Pose
from soar.synthetic.settings import PoseSettings

_Draw = dict[str, float]

_SHARES = (
    np.array([1.0]),
    np.array([0.92, 0.84, 0.76]),
)  # of what sets a drawn pose apart from standing; tried in turn


def _both(rng: np.random.Generator, **ranges: tuple[float, float]) -> _Draw:
    return {f"{side}_{name}": rng.uniform(*span) for name, span in ranges.items() for side in "lr"}


def _stand(rng: np.random.Generator) -> _Draw:
    rest = rng.uniform(-6, 6)
    side = "l" if rest > 0 else "r"
    return {
        **_both(rng, **{"raise": (8, 24), "plane": (0, 60), "roll": (-5, 30), "elbow": (8, 40)}, abduct=(-3, 6),
            out=(0, 14)),
        f"{side}_hip": abs(rest) * 1.2, f"{side}_knee": abs(rest) * 2.5, "side": 0.4 * rest,
    }  # fmt: skip


def _walk(rng: np.random.Generator) -> _Draw:
    return walk_angles(rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.2), rng.uniform(0.6, 1.3))


def walk_angles(phase: np.ndarray | float, stride: float, swing: float) -> dict[str, np.ndarray]:
    """A step cycle: ``phase`` 0 to 2 pi, left leg foremost at pi / 2; ``stride`` and ``swing`` scale legs and arms."""
    out: dict[str, np.ndarray] = {}
    for side, shift in (("l", 0.0), ("r", np.pi)):
        p = np.asarray(phase) + shift
        out[f"{side}_hip"] = 6 + 24 * stride * np.sin(p)
        # The knee bends while the leg swings forward, and gives a little when it takes the weight.
        swung, loaded = np.exp(2.2 * (np.cos(p + 0.25) - 1)), np.exp(3 * (np.cos(p - 2.2) - 1))
        out[f"{side}_knee"] = 6 + stride * (48 * swung + 6 * loaded)
        out[f"{side}_ankle"] = 8 * stride * np.sin(p) - 14 * stride * np.exp(3 * (np.cos(p + 1.1) - 1))
        out[f"{side}_raise"] = 14 + 17 * swing * np.abs(np.sin(p + np.pi)) ** 1.2
        out[f"{side}_plane"] = 30 + 55 * np.sin(p + np.pi)
        out[f"{side}_elbow"] = 22 + 12 * swing * (1 + np.sin(p + np.pi))
        out[f"{side}_abduct"] = -1.5 + 0 * p
    out["twist"], out["bend"] = 5 * swing * np.sin(np.asarray(phase) + np.pi), 3 + 0 * np.asarray(phase)
    out["turn"] = -0.7 * out["twist"]
    return out


def _reach(rng: np.random.Generator) -> _Draw:
    side, other = ("l", "r") if rng.uniform() < 0.5 else ("r", "l")
    sign = 1 if side == "l" else -1
    level = rng.uniform(45, 150)
    return {
        **_stand(rng), f"{side}_raise": level, f"{side}_plane": rng.uniform(10, 95),
        f"{side}_elbow": rng.uniform(5, 50), f"{side}_curl": rng.uniform(0, 40),
        "twist": -sign * rng.uniform(0, 22), "side": -sign * rng.uniform(0, 10),
        "bend": rng.uniform(-2, 20), "turn": sign * rng.uniform(-10, 35), "nod": -0.2 * (level - 90),
        f"{other}_hip": rng.uniform(-4, 8),
    }  # fmt: skip


def _dance(rng: np.random.Generator) -> _Draw:
    return {
        **_both(rng, **{"raise": (25, 150), "plane": (-15, 85), "roll": (-40, 50), "elbow": (10, 115), "palm": (-30,
                        40)},
                curl=(0, 50), hip=(0, 45), abduct=(0, 26), out=(0, 25), knee=(5, 60)),
        "bend": rng.uniform(-6, 18), "side": rng.uniform(-15, 15), "twist": rng.uniform(-25, 25),
        "turn": rng.uniform(-35, 35), "nod": rng.uniform(-15, 15), "tilt": rng.uniform(-12, 12),
    }  # fmt: skip


def _akimbo(rng: np.random.Generator) -> _Draw:
    sides = ("lr", "l", "r")[rng.choice(3, p=[0.6, 0.2, 0.2])]
    out = _stand(rng)
    for side in sides:
        out |= {
            f"{side}_raise": rng.uniform(38, 50), f"{side}_plane": rng.uniform(-32, -14),
                f"{side}_roll": rng.uniform(58, 74),
            f"{side}_elbow": rng.uniform(88, 104), f"{side}_curl": rng.uniform(15, 45),
                f"{side}_palm": rng.uniform(-15, 15),
        }  # fmt: skip
    return out


def _raised(rng: np.random.Generator) -> _Draw:
    sides = ("lr", "l", "r")[rng.choice(3, p=[0.6, 0.2, 0.2])]
    out = _stand(rng)
    for side in sides:
        out |= {
            f"{side}_raise": rng.uniform(95, 168), f"{side}_plane": rng.uniform(-5, 40),
                f"{side}_elbow": rng.uniform(4, 90),
            f"{side}_roll": rng.uniform(-50, 10), f"{side}_curl": rng.uniform(0, 60),
        }  # fmt: skip
    return out


def _twist(rng: np.random.Generator) -> _Draw:
    way = rng.choice([-1.0, 1.0])
    out = {
        **_stand(rng),
        "twist": way * rng.uniform(15, 40),
        "turn": way * rng.uniform(5, 45),
        "side": rng.uniform(-10, 10),
    }
    return out | _both(rng, **{"raise": (15, 70), "plane": (10, 80), "elbow": (15, 85)})


def _crouch(rng: np.random.Generator) -> _Draw:
    depth = rng.uniform(0.25, 1.0)
    return {
        **_both(rng, **{"raise": (20, 75), "plane": (40, 90), "elbow": (30, 95)}, abduct=(4, 18), out=(5, 25)),
        **{f"{s}_{name}": value * depth + rng.uniform(-4, 4) for s in "lr" for name, value in (("hip", 75), ("knee",
           95), ("ankle", 8))},
        "bend": 30 * depth * rng.uniform(0.4, 1.0), "nod": -12 * depth,
    }  # fmt: skip


def _open(rng: np.random.Generator) -> _Draw:
    return _both(
        rng, **{"raise": (35, 95), "plane": (-5, 20), "elbow": (4, 25)}, abduct=(0, 14), out=(0, 15), curl=(0, 25)
    )


KINDS: dict[str, Callable[[np.random.Generator], _Draw]] = {
    "stand": _stand, "walk": _walk, "reach": _reach, "dance": _dance, "akimbo": _akimbo, "raised": _raised,
    "twist": _twist, "crouch": _crouch, "open": _open,
}  # fmt: skip


def draw_pose(mannequin: Mannequin, rng: np.random.Generator, settings: PoseSettings) -> Pose:
    """A pose of a kind drawn with its weight; feet on the ground, heading free of choice (facing -y).

    Raises:
        ConfigError: a weight names no kind of pose.
    """
    unknown = sorted(set(settings.weights) - set(KINDS))
    if unknown:
        raise ConfigError("unknown kind of pose", expected=", ".join(KINDS), got=unknown[0])
    names = sorted(settings.weights)  # the order in a configuration file says nothing
    p = np.array([settings.weights[name] for name in names], float)
    kind = names[rng.choice(len(names), p=p / p.sum())]
    for _ in range(settings.attempts):
        drawn = {name: float(value) for name, value in KINDS[kind](rng).items()}
        angles = {name: drawn.get(name, NEUTRAL[name]) + rng.normal(0, 0.35 * settings.variation) for name in NEUTRAL}
        for name in ("turn", "nod", "twist"):
            angles[name] += rng.normal(0, settings.variation)
        # A pose in contact is first relaxed a little towards standing: hands come to lie on hips.
        for shares in _SHARES:
            eased = {name: NEUTRAL[name] + shares * (value - NEUTRAL[name]) for name, value in angles.items()}
            rotations = mannequin.rotations(eased)
            points, normals = mannequin.skinned(rotations)
            free = np.flatnonzero(mannequin.contact(points, normals) < settings.clearance)
            if len(free):
                break
        if len(free):
            break
    best = free[0] if len(free) else -1
    return Pose(kind, mannequin.axis_angles(rotations[[best]])[0], mannequin.standing(points)[best])
