"""A small whole body for tests: an ellipsoid per bone, two shape components, the 25 body keypoints, and cameras."""

from __future__ import annotations

import math

import numpy as np
import torch
import trimesh

from soar.body import lbs
from soar.body.motion import BodyMotion
from soar.body.observations import Observations
from soar.body.openpose import BODY, COUNT, INDEX
from soar.body.record import BodyModel
from soar.geometry.cameras import Camera
from soar.geometry.rotations import axis_angle_to_matrix

# name -> (parent, rest position); the left side is +X, the body faces -Y and stands along Z.
_HALF = {
    "hip": ("root", (0.1, 0.0, -0.05)), "knee": ("hip", (0.12, -0.02, -0.45)), "ankle": ("knee", (0.12, 0.02, -0.85)),
    "shoulder": ("spine", (0.18, 0.0, 0.45)), "elbow": ("shoulder", (0.42, 0.02, 0.35)),
    "wrist": ("elbow", (0.6, -0.1, 0.2)), "tip": ("wrist", (0.68, -0.14, 0.14)),
}  # fmt: skip
_MIDDLE = {"root": (None, (0.0, 0.0, 0.0)), "spine": ("root", (0.0, 0.02, 0.2)), "head": ("spine", (0.0, 0.0, 0.55))}
_PASSIVE = ("left_tip", "right_tip")  # ride on the wrists


def _joints() -> dict[str, tuple[str | None, np.ndarray]]:
    joints = {name: (parent, np.array(p)) for name, (parent, p) in _MIDDLE.items()}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for name, (parent, p) in _HALF.items():
            up = parent if parent in _MIDDLE else f"{side}_{parent}"
            joints[f"{side}_{name}"] = (up, np.array(p) * (sign, 1, 1))
    return joints


def body(dtype: torch.dtype = torch.float64) -> BodyModel:
    """1.6 m tall; beta 0 scales it by 8 % per unit, beta 1 widens it by 20 %."""
    joints = _joints()
    names = list(joints)
    J = np.stack([p for _, p in joints.values()])
    parents = [-1 if up is None else names.index(up) for up, _ in joints.values()]
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces, owner = [], [], []
    places: dict[str, int] = {}
    bones = [(parents[j], J[parents[j]], J[j], 0.06) for j in range(1, len(names))]
    bones.append((names.index("head"), J[2], J[2] + np.array([0, 0, 0.2]), 0.09))
    ankles = names.index("left_ankle"), names.index("right_ankle")
    bones += [(ankle, J[ankle], J[ankle] + np.array([0, -0.16, -0.05]), 0.04) for ankle in ankles]
    for joint, a, b, radius in bones:
        frame = trimesh.geometry.align_vectors([0, 0, 1], b - a)[:3, :3]
        length = np.linalg.norm(b - a)
        faces.append(sphere.faces + sum(map(len, vertices)))
        vertices.append((sphere.vertices * (radius, radius, length / 2 + radius / 2)) @ frame.T + (a + b) / 2)
        owner += [joint] * len(sphere.vertices)
    v = np.concatenate(vertices)
    owner_of = np.array(owner)

    def nearest(joint: str, point: np.ndarray) -> int:
        mine = np.flatnonzero(owner_of == names.index(joint))
        return int(mine[np.linalg.norm(v[mine] - point, axis=1).argmin()])

    head = J[2]
    places["nose"] = nearest("head", head + np.array([0, -0.2, 0.08]))
    for s, sign in (("left", 1.0), ("right", -1.0)):
        foot = J[names.index(f"{s}_ankle")]
        places[f"{s}_eye"] = nearest("head", head + np.array([0.04 * sign, -0.2, 0.14]))
        places[f"{s}_ear"] = nearest("head", head + np.array([0.2 * sign, 0, 0.1]))
        places[f"{s}_big_toe"] = nearest(f"{s}_ankle", foot + np.array([-0.02 * sign, -0.3, -0.05]))
        places[f"{s}_heel"] = nearest(f"{s}_ankle", foot + np.array([0, 0.2, 0]))
    entries = []
    for name in BODY:
        if name in places:
            entries.append((INDEX[name], places[name], 1.0))
        elif name in names:
            entries.append((INDEX[name], len(v) + names.index(name), 1.0))
    for middle, part in (("neck", "shoulder"), ("mid_hip", "hip")):
        entries += [(INDEX[middle], len(v) + names.index(f"{s}_{part}"), 0.5) for s in ("left", "right")]
    rows, columns, values = zip(*entries, strict=True)
    widen = np.array([0.2, 0, 0])
    valid = torch.zeros(COUNT, dtype=torch.bool)
    valid[list(rows)] = True
    active = [j for j, name in enumerate(names) if name not in _PASSIVE]

    def tensor(x: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.asarray(x), dtype=dtype)

    return BodyModel(
        name="stickman", up=tensor([0, 0, 1.0]), front=tensor([0, -1.0, 0]), left=tensor([1.0, 0, 0]),
        v_template=tensor(v), shapedirs=tensor(np.stack([0.08 * v, widen * v], -1)),
        J_template=tensor(J), J_shapedirs=tensor(np.stack([0.08 * J, widen * J], -1)),
        weights=tensor(np.eye(len(names))[owner_of]), parents=torch.tensor(parents),
        faces=torch.tensor(np.concatenate(faces)), joint_names=tuple(names),
        interior=torch.zeros(sum(map(len, faces)), dtype=torch.bool), keypoint_rows=torch.tensor(rows),
        keypoint_columns=torch.tensor(columns), keypoint_values=tensor(values), keypoint_valid=valid,
        canonical_pose=torch.zeros(len(names), 3, dtype=dtype), active=torch.tensor(active),
        stiffness=tensor([0.0 if j == 0 else 1.0 for j in range(len(names))]),
    )  # fmt: skip


def motion(model: BodyModel, frames: int = 6) -> BodyMotion:
    """A slow dance: the trunk turns, arms and legs swing, no joint by more than half a radian."""
    generator = torch.Generator().manual_seed(3)
    amplitude = 0.35 * torch.randn(len(model.joint_names), 3, generator=generator, dtype=torch.float64).clamp(-1.4, 1.4)
    amplitude[[model.joint_names.index(name) for name in _PASSIVE]] = 0
    phase = torch.linspace(0, 1.2, frames, dtype=torch.float64)[:, None, None]
    pose = amplitude * torch.sin(phase + torch.arange(len(model.joint_names))[:, None])
    pose[:, 0] = torch.tensor([0.1, 0.05, 0.4], dtype=torch.float64) + 0.2 * phase[:, 0]
    translation = torch.tensor([0.2, -0.1, 0.9], dtype=torch.float64) + phase[:, 0] * torch.tensor(
        [0.05, 0.1, 0.0], dtype=torch.float64
    )
    betas = torch.tensor([0.6, -0.4], dtype=torch.float64)
    return BodyMotion(betas, pose, translation, torch.zeros(COUNT, 3, dtype=torch.float64))


def cameras(count: int, size: tuple[int, int] = (480, 640)) -> tuple[Camera, ...]:
    """Cameras on a ring, 4 m away and 1.4 m high, looking at (0, 0, 1); the first one sees the front."""
    found = []
    for i in range(count):
        angle = -math.pi / 2 + 2 * math.pi * i / max(count, 3)
        centre = np.array([4 * math.cos(angle), 4 * math.sin(angle), 1.4])
        forward = np.array([0, 0, 1.0]) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -R @ centre
        K = np.array([[900.0, 0, size[0] / 2], [0, 900.0, size[1] / 2], [0, 0, 1]])
        found.append(Camera(f"cam{i}", *size, K, T, np.zeros(5), "test"))
    return tuple(found)


def observe(
    model: BodyModel, moved: BodyMotion, views: tuple[Camera, ...], noise_px: float = 0.0, seed: int = 0
) -> Observations:
    """What perfect detectors would report of a motion, with Gaussian noise."""
    points = lbs.keypoints(model, moved.betas, axis_angle_to_matrix(moved.pose), moved.translation).numpy()
    rng = np.random.default_rng(seed)
    valid = model.keypoint_valid.numpy()
    keypoints, world = [], []
    for camera in views:
        pixels = camera.project(points) + noise_px * rng.standard_normal((*points.shape[:2], 2))
        keypoints.append(np.concatenate([pixels, np.broadcast_to(valid[:, None], (*points.shape[:2], 1))], -1))
        local = (points - points[:, INDEX["mid_hip"], None]) @ camera.R.T
        world.append(local[:, : len(BODY)])
    return Observations.gather(views, keypoints, world, 0.3)
