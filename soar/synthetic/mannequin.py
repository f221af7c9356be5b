"""From anatomical angles to the rotations of a body, feet on the ground, and how deep its limbs press into each other.

Angles are degrees. ``l`` and ``r`` stand for the sides; every angle means the same for both.

=============  ====================================================================================================
``bend``       trunk forwards; ``side``: to the left; ``twist``: to the left
``nod``        head downwards; ``turn``: to the left; ``tilt``: to the left shoulder
``raise``      upper arm away from hanging: 90 is level, 180 straight up
``plane``      the plane it is raised in: 0 sideways, 90 forwards
``roll``       upper arm turned inwards about itself
``elbow``      0 is straight
``palm``       hand bent towards the palm; ``curl``: fingers bent, 0 flat, 90 a fist
``hip``        thigh forwards; ``abduct``: outwards; ``out``: turned outwards about itself
``knee``       0 is straight
``ankle``      toes up, from a sole as level as the leg's bend would have it
=============  ====================================================================================================
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
import torch

from soar.body.record import BodyModel
from soar.geometry.rotations import matrix_to_axis_angle

Angles = Mapping[str, np.ndarray | float]
_Put = Callable[[str | list[str], np.ndarray], None]

_TRUNK = {
    "bend": (-20, 60),
    "side": (-25, 25),
    "twist": (-45, 45),
    "nod": (-35, 40),
    "turn": (-65, 65),
    "tilt": (-25, 25),
}
_SIDED = {
    "raise": (0, 172), "plane": (-45, 120), "roll": (-70, 85), "elbow": (3, 145), "palm": (-45, 60), "curl": (0, 85),
    "hip": (-25, 110), "abduct": (-15, 50), "out": (-25, 45), "knee": (0, 135), "ankle": (-40, 25),
}  # fmt: skip
LIMITS: dict[str, tuple[float, float]] = {
    **_TRUNK,
    **{f"{side}_{name}": limit for name, limit in _SIDED.items() for side in "lr"},
}
NEUTRAL: dict[str, float] = {
    **dict.fromkeys(_TRUNK, 0.0),
    **{
        f"{side}_{name}": value
        for name, value in {
            "raise": 12.0, "plane": 20.0, "roll": 10.0, "elbow": 18.0, "palm": 5.0, "curl": 22.0, "hip": 0.0,
            "abduct": -1.0, "out": 4.0, "knee": 3.0, "ankle": 0.0,
        }.items()
        for side in "lr"
    },
}  # fmt: skip

_PROXIES = 600  # points of the skin that stand for it in tests of contact


def within_limits(angles: Angles) -> dict[str, np.ndarray]:
    """Every angle, clamped to its joint's range; those not given are neutral."""
    return {name: np.clip(angles.get(name, NEUTRAL[name]), low, high) for name, (low, high) in LIMITS.items()}


# axis @ _CROSS is the axis' cross-product matrix, flat.
_CROSS = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], float)
_SPINE = {"spine05": 0.2, "spine04": 0.3, "spine03": 0.2, "spine02": 0.3}  # shares of the trunk's angles
_FINGERS = {
    **{f"finger{f}-{k}": share for f in (2, 3, 4, 5) for k, share in ((1, 0.8), (2, 1.0), (3, 0.6))},
    "finger1-2": 0.4, "finger1-3": 0.4,
}  # fmt: skip


def _about(axis: np.ndarray, degrees: np.ndarray | float) -> np.ndarray:
    """(..., 3, 3) rotation about unit axes (..., 3) by angles (...)."""
    angle = np.radians(np.asarray(degrees, float))[..., None, None]
    axis = np.asarray(axis)
    K = (axis @ _CROSS).reshape(*axis.shape, 3)
    cosine = np.cos(angle)
    return cosine * np.eye(3) + np.sin(angle) * K + (1 - cosine) * axis[..., :, None] * axis[..., None, :]


def _shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation of least angle from unit ``source`` (3,) to unit ``target`` (..., 3)."""
    cosine = target @ source
    axis = np.cross(source, target)
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    return _about(axis / np.maximum(length, 1e-12), np.degrees(np.arctan2(length[..., 0], cosine)))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


_X, _Y, _Z = np.eye(3)


class Rig:
    """What mannequins of all shapes share: joints, and points of the skin that stand for it (z up, facing -y)."""

    def __init__(self, body: BodyModel) -> None:
        self.names = body.joint_names
        self.index = {name: i for i, name in enumerate(self.names)}
        self.parents = body.parents.tolist()
        self.J_template, self.J_shapedirs = body.J_template.double().numpy(), body.J_shapedirs.double().numpy()
        chosen = _chosen(body)
        self.template, self.shapedirs = (x[chosen].double().numpy() for x in (body.v_template, body.shapedirs))
        self.normals, self.weights = _normals(body)[chosen], body.weights[chosen].double().numpy()
        dominant = [self.names[i] for i in self.weights.argmax(1)]
        self.part = {
            part: np.flatnonzero([n.startswith(starts) and (not side or n.endswith(side)) for n in dominant])
            for part, starts, side in (
                ("trunk", ("root", "pelvis", "spine", "clavicle", "neck", "head"), ""),
                *((f"hand{s}", ("lowerarm02", "wrist", "metacarpal", "finger"), s) for s in (".L", ".R")),
                *((f"leg{s}", ("upperleg", "lowerleg", "foot", "toe"), s) for s in (".L", ".R")),
                *((f"shin{s}", ("lowerleg", "foot", "toe"), s) for s in (".L", ".R")),
            )
        }
        self.feet = np.concatenate([self.part["shin.L"], self.part["shin.R"]])


class Mannequin:
    """A body of one shape that is posed by angles.

    Args:
        rig: of the body.
        betas: (B,) its shape.
    """

    def __init__(self, rig: Rig, betas: np.ndarray) -> None:
        self.rig = rig
        b = np.asarray(betas, np.float64)
        self.joints = rig.J_template + rig.J_shapedirs @ b
        self._rest = {joint: self.joints[i] for joint, i in rig.index.items()}
        self._points = rig.template + rig.shapedirs @ b
        self.ground = float(self._points[:, 2].min())

    def rotations(self, angles: Angles) -> np.ndarray:
        """(T, J, 3, 3) local rotations; angles are numbers or (T,), the root stays upright."""
        a = within_limits(angles)
        count = max(np.size(value) for value in a.values())
        a = {name: np.broadcast_to(value, (count,)) for name, value in a.items()}
        R = np.tile(np.eye(3), (count, len(self.rig.names), 1, 1))

        def put(joints: str | list[str], rotation: np.ndarray) -> None:
            R[:, [self.rig.index[j] for j in joints] if isinstance(joints, list) else self.rig.index[joints]] = rotation

        shares = np.array(list(_SPINE.values()))
        twist, side, bend = (a[name][:, None] * shares for name in ("twist", "side", "bend"))
        put(list(_SPINE), _about(_Z, twist) @ _about(_Y, side) @ _about(_X, bend))
        head = _about(_Z, 0.5 * a["turn"]) @ _about(_Y, 0.5 * a["tilt"]) @ _about(_X, 0.5 * a["nod"])
        put(["neck01", "head"], head[:, None])
        for side, sign in (("l", 1.0), ("r", -1.0)):
            self._arm(put, {name: a[f"{side}_{name}"] for name in _SIDED}, side.upper(), sign)
            self._leg(put, {name: a[f"{side}_{name}"] for name in _SIDED}, side.upper(), sign)
        return R

    def _arm(self, put: _Put, a: dict[str, np.ndarray], side: str, sign: float) -> None:
        shoulder, elbow, wrist = (self._rest[f"{j}.{side}"] for j in ("upperarm01", "lowerarm01", "wrist"))
        upper, fore = _unit(elbow - shoulder), _unit(wrist - elbow)
        # The collar bone takes a share of what the arm is raised beyond 40 degrees.
        lift = 0.22 * np.maximum(0.0, a["raise"] - 40)
        shrug = _about(_Y, -sign * lift)
        put(f"clavicle.{side}", shrug)
        up, plane = np.radians(a["raise"]), np.radians(a["plane"])
        target = np.stack([sign * np.sin(up) * np.cos(plane), -np.sin(up) * np.sin(plane), -np.cos(up)], -1)
        swing = _about(target, sign * a["roll"]) @ _shortest(upper, target)
        put(f"upperarm01.{side}", np.swapaxes(shrug, -1, -2) @ swing)
        hinge = _unit(np.cross(upper, fore))
        at_rest = np.degrees(np.arccos(np.clip(upper @ fore, -1, 1)))
        put(f"lowerarm01.{side}", _about(hinge, a["elbow"] - at_rest))
        knuckles = [self._rest[f"finger{k}-1.{side}"] for k in (2, 3, 4, 5)]
        across = _unit(knuckles[0] - knuckles[3])  # towards the thumb
        pointing = _unit(np.mean(knuckles, 0) - wrist)
        bend = _unit(across - (across @ pointing) * pointing) * -sign
        if bend @ np.cross(pointing, self._palm(side, pointing, across)) < 0:
            bend = -bend
        put(f"wrist.{side}", _about(bend, a["palm"]))
        shares = np.array(list(_FINGERS.values()))
        put([f"{finger}.{side}" for finger in _FINGERS], _about(bend, a["curl"][:, None] * shares))

    def _palm(self, side: str, pointing: np.ndarray, across: np.ndarray) -> np.ndarray:
        """The direction the palm looks: where the resting finger ends bend to."""
        base, end = self._rest[f"finger3-1.{side}"], self._rest[f"finger3-3.{side}"]
        curl = _unit(end - base)
        out = curl - (curl @ pointing) * pointing
        return _unit(out - (out @ across) * across)

    def _leg(self, put: _Put, a: dict[str, np.ndarray], side: str, sign: float) -> None:
        thigh = _about(_X, -a["hip"]) @ _about(_Y, -sign * a["abduct"]) @ _about(_Z, sign * a["out"])
        put(f"upperleg01.{side}", thigh)
        put(f"lowerleg01.{side}", _about(_X, a["knee"]))
        level = np.clip(a["hip"] - a["knee"], -45, 30)
        put(f"foot.{side}", _about(_Y, 0.7 * sign * a["abduct"]) @ _about(_X, level - a["ankle"]))

    def axis_angles(self, rotations: np.ndarray) -> np.ndarray:
        """(T, J, 3) radians, float32."""
        return matrix_to_axis_angle(torch.from_numpy(rotations)).numpy().astype(np.float32)

    def skinned(self, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the skin (T, N, 3) that stand for it, and their normals, the root at its rest place."""
        T, J = rotations.shape[:2]
        G, t = np.empty((T, J, 3, 3)), np.empty((T, J, 3))
        for j, parent in enumerate(self.rig.parents):
            if parent < 0:
                G[:, j], t[:, j] = rotations[:, j], self.joints[j]
            else:
                G[:, j] = G[:, parent] @ rotations[:, j]
                t[:, j] = t[:, parent] + G[:, parent] @ (self.joints[j] - self.joints[parent])
        shift = t - (G @ self.joints[:, :, None])[..., 0]
        blend = np.einsum("nj,tjab->tnab", self.rig.weights, G, optimize=True)
        points = np.einsum("tnab,nb->tna", blend, self._points) + np.einsum(
            "nj,tja->tna", self.rig.weights, shift, optimize=True
        )
        return points, _unit(np.einsum("tnab,nb->tna", blend, self.rig.normals))

    def standing(self, points: np.ndarray) -> np.ndarray:
        """(T, 3) translation that puts the lowest of the feet's points (T, N, 3) on the ground of the rest pose."""
        lowest = points[:, self.rig.feet, 2].min(1)
        out = np.zeros((len(points), 3), np.float32)
        out[:, 2] = self.ground - lowest
        return out

    def contact(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(T,) how deep, metres, hands press into trunk, legs or each other and shins into the other leg."""
        part = self.rig.part
        pairs = [(f"hand.{s}", other) for s in "LR" for other in ("trunk", "leg.L", "leg.R")]
        pairs += [("hand.L", "hand.R"), ("shin.L", "leg.R"), ("shin.R", "leg.L")]
        deepest = np.zeros(len(points))
        for mover, still in pairs:
            p, q, n = points[:, part[mover]], points[:, part[still]], normals[:, part[still]]
            square = (p**2).sum(-1)[:, :, None] + (q**2).sum(-1)[:, None] - 2 * p @ np.swapaxes(q, 1, 2)
            nearest = square.argmin(2)
            gap = p - np.take_along_axis(q, nearest[..., None], 1)
            depth = -(gap * np.take_along_axis(n, nearest[..., None], 1)).sum(-1)
            near = np.take_along_axis(square, nearest[..., None], 2)[..., 0] < 0.12**2
            deepest = np.maximum(deepest, np.where(near, depth, 0).max(1))
        return deepest


def _chosen(body: BodyModel) -> np.ndarray:
    """Evenly spread vertices of the visible skin; hands and feet, which are dense, count no more than their share."""
    visible = np.unique(body.faces.numpy()[~body.interior.numpy()])
    area = np.zeros(len(body.v_template))
    corners = body.v_template.numpy()[body.faces.numpy()]
    size = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for k in range(3):
        np.add.at(area, body.faces.numpy()[:, k], size)
    share = np.cumsum(np.sqrt(area[visible]))
    picks = np.searchsorted(share, (np.arange(_PROXIES) + 0.5) / _PROXIES * share[-1])
    return np.unique(visible[picks])


def _normals(body: BodyModel) -> np.ndarray:
    v, f = body.v_template.double().numpy(), body.faces.numpy()
    n = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    out = np.zeros_like(v)
    for k in range(3):
        np.add.at(out, f[:, k], n)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


@dataclasses.dataclass(frozen=True)
class Pose:
    """Axis-angle (J, 3) radians and translation (3,) metres: one frame of a body motion; how it was drawn."""

    kind: str
    pose: np.ndarray
    translation: np.ndarray
