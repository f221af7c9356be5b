"""A stand-in for SMPL-X: its 55 joints and axes on a body of ellipsoids, cameras, and poses worked out step by step."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from soar.body.openpose import BODY, COUNT, INDEX
from soar.body.record import BodyModel
from soar.body.smplx_file import JOINTS, PARENTS
from soar.geometry.cameras import Camera

# Offsets from the parent, metres; the left side. x left, y up, z front.
_OFFSETS = {
    "left_hip": (0.06, -0.09, 0.0), "left_knee": (0.04, -0.38, 0.0), "left_ankle": (-0.01, -0.4, -0.04),
    "left_foot": (0.04, -0.06, 0.12), "spine1": (0, 0.11, -0.02), "spine2": (0, 0.13, 0), "spine3": (0, 0.06, 0.02),
    "neck": (0, 0.21, -0.03), "head": (0, 0.1, 0.05), "left_collar": (0.07, 0.11, -0.02),
    "left_shoulder": (0.11, 0.05, -0.02), "left_elbow": (0.26, -0.01, -0.02), "left_wrist": (0.25, 0.01, 0.0),
    "jaw": (0, 0.02, 0.02), "left_eye_smplhf": (0.03, 0.06, 0.06),
}  # fmt: skip
_FINGERS = {"index": 0.03, "middle": 0.01, "pinky": -0.04, "ring": -0.02, "thumb": 0.05}
PELVIS = np.array([0.003, -0.351, 0.012])
BETAS = 4


def _offset(name: str) -> np.ndarray:
    left = name.replace("right_", "left_")
    if left in _OFFSETS:
        offset = np.array(_OFFSETS[left])
    else:
        finger = left.removeprefix("left_")
        reach = 0.09 if finger[-1] == "1" else 0.03
        offset = np.array([reach, 0.0, _FINGERS[finger[:-1]] if finger[-1] == "1" else 0.0])
    return offset * (-1 if name.startswith("right_") else 1, 1, 1)


def body(dtype: torch.dtype = torch.float64, pelvis: np.ndarray = PELVIS) -> BodyModel:
    """1.6 m tall. Beta 0 scales it about its origin by 5 % per unit, so that it moves the pelvis; beta 1 widens it."""
    joints = np.zeros((len(JOINTS), 3))
    joints[0] = pelvis
    for j, parent in enumerate(PARENTS[1:], start=1):
        joints[j] = joints[parent] + _offset(JOINTS[j])
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices, faces, owner = [], [], []
    for j, parent in enumerate(PARENTS[1:], start=1):
        thin = 0.008 if j >= 25 else 0.05
        bone = joints[j] - joints[parent]
        frame = trimesh.geometry.align_vectors([0, 0, 1], bone)[:3, :3]
        faces.append(ball.faces + sum(map(len, vertices)))
        shape = (thin, thin, np.linalg.norm(bone) / 2 + thin)
        vertices.append((ball.vertices * shape) @ frame.T + (joints[j] + joints[parent]) / 2)
        owner += [parent] * len(ball.vertices)
    v, owners = np.concatenate(vertices), np.array(owner)
    rows = []
    for name in BODY:
        side = name.split("_")[0]
        joint = {"mid_hip": "pelvis", "nose": "jaw", f"{side}_eye": f"{side}_eye_smplhf"}.get(name, name)
        if joint.endswith(("toe", "heel")):
            joint = f"{side}_foot"
        if joint in JOINTS:
            rows.append((INDEX[name], len(v) + JOINTS.index(joint)))
    valid = torch.zeros(COUNT, dtype=torch.bool)
    valid[[row for row, _ in rows]] = True
    rng = np.random.default_rng(5)
    active = [j for j in range(len(JOINTS)) if not 22 <= j < 25]

    def tensor(x: object) -> torch.Tensor:
        return torch.tensor(np.asarray(x), dtype=dtype)

    def dirs(x: np.ndarray) -> np.ndarray:
        return np.stack([0.05 * x, x * (0.1, 0, 0), 0 * x, 0 * x], -1)

    return BodyModel(
        name="smplx", up=tensor([0.0, 1, 0]), front=tensor([0.0, 0, 1]), left=tensor([1.0, 0, 0]),
        v_template=tensor(v), shapedirs=tensor(dirs(v)), J_template=tensor(joints), J_shapedirs=tensor(dirs(joints)),
        weights=tensor(np.eye(len(JOINTS))[owners]), parents=torch.tensor(PARENTS),
        faces=torch.tensor(np.concatenate(faces)), joint_names=JOINTS,
        interior=torch.zeros(sum(map(len, faces)), dtype=torch.bool),
        keypoint_rows=torch.tensor([row for row, _ in rows]), keypoint_columns=torch.tensor([c for _, c in rows]),
        keypoint_values=tensor(np.ones(len(rows))), keypoint_valid=valid,
        canonical_pose=torch.zeros(len(JOINTS), 3, dtype=dtype), active=torch.tensor(active),
        stiffness=tensor([float(j > 0) for j in range(len(JOINTS))]),
        hand_mean=tensor(rng.uniform(-0.3, 0.3, (2, 45))),
        hand_components=tensor(np.stack([np.linalg.qr(rng.standard_normal((45, 45)))[0] for _ in range(2)])),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Truth:
    """What a person does in front of a camera, in its axes: T frames, axis-angle, the translation added last."""

    frames: np.ndarray
    orient: np.ndarray
    body: np.ndarray
    hands: np.ndarray
    face: np.ndarray
    transl: np.ndarray
    betas: np.ndarray

    def pose(self) -> np.ndarray:
        """(T, 55, 3)."""
        parts = (self.orient[:, None], self.body, self.face, self.hands.reshape(len(self.frames), 30, 3))
        return np.concatenate(parts, 1)


def truth(frames: int = 5, depth: float = 4.0, seed: int = 1, aside: float = 0.0) -> Truth:
    """An upright person who faces the camera and moves, ``aside`` metres from its axis."""
    rng = np.random.default_rng(seed)
    rate = np.linspace(0, 1, frames)[:, None]
    turn = [rotation(np.array([0, 0.3 * s + 0.2, 0.1])) for s in rate[:, 0]]
    orient = np.stack([rotation_vector(rotation(np.array([np.pi, 0, 0])) @ R) for R in turn])
    swing = rng.uniform(-0.3, 0.3, (21, 3))
    return Truth(
        frames=np.arange(frames), orient=orient, body=swing * (0.5 + 0.5 * rate[:, :, None]),
        hands=rng.uniform(-0.4, 0.4, (frames, 2, 45)), face=rng.uniform(-0.1, 0.1, (frames, 3, 3)),
        transl=np.array([aside, -0.35, depth]) + 0.1 * rate, betas=np.array([0.7, -0.5, 0.0, 0.0]),
    )  # fmt: skip


def rotation(v: np.ndarray) -> np.ndarray:
    """(3, 3) of an axis-angle."""
    return np.asarray(Rotation.from_rotvec(v).as_matrix())


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Axis-angle of a rotation."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def joints(model: BodyModel, pose: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """(55, 3) joints of one frame (55, 3) axis-angle, joint by joint, without a translation."""
    rest = model.J_template.double().numpy() + model.J_shapedirs.double().numpy()[..., : len(betas)] @ betas
    turned, placed = [rotation(pose[0])], [rest[0]]
    for j, parent in enumerate(PARENTS[1:], start=1):
        placed.append(placed[parent] + turned[parent] @ (rest[j] - rest[parent]))
        turned.append(turned[parent] @ rotation(pose[j]))
    return np.stack(placed)


def joints_of(model: BodyModel, what: Truth) -> np.ndarray:
    """(T, 55, 3) joints in the camera's axes."""
    return np.stack([joints(model, p, what.betas) + t for p, t in zip(what.pose(), what.transl, strict=True)])


def camera(focal: float = 900.0, size: tuple[int, int] = (640, 480), T: np.ndarray | None = None) -> Camera:
    """A camera with the principal point in the middle."""
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return Camera("cam0", *size, K, np.eye(4) if T is None else T, np.zeros(5), "test")


def elsewhere() -> np.ndarray:
    """(4, 4) the pose of a camera in a world with other axes."""
    T = np.eye(4)
    T[:3, :3] = rotation(np.array([1.2, -0.4, 0.3]))
    T[:3, 3] = 0.5, -1.0, 2.0
    return T
