"""A small body for tests: an ellipsoid with a bone in each half, its motion, and a camera that looks at it."""

from __future__ import annotations

import math

import torch
import trimesh
from torch import Tensor

from soar.avatar.settings import AvatarSettings, FieldSettings
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT
from soar.body.record import BodyModel
from soar.raster import Pinhole, RasterSettings

RASTER = RasterSettings(lowpass_px2=1 / 12, compensate=True, cull=True, backend="auto")
FIELD = FieldSettings(
    levels=4, features=2, table_log2=8, coarsest=4, finest=32, hidden=8, scale_max=0.05, margin=1.5, residual=True,
    prefit_steps=0, prefit_rate=1e-2, chunk=64,
)  # fmt: skip


def avatar_settings(
    attributes: str = "explicit", field: FieldSettings = FIELD, subdivisions: int = 0
) -> AvatarSettings:
    """A surfel per vertex, whose 5 nearest vertices are near."""
    return AvatarSettings(
        subdivisions=subdivisions,
        longest_edge=10.0,
        scale_neighbours=3,
        neighbours=5,
        attributes=attributes,
        field=field,
    )


def body(dtype: torch.dtype = torch.float32) -> BodyModel:
    """An ellipsoid, 0.3 m wide, from z = -0.1 to 1.1 m; joint 1 at half height, joint 2 rides on joint 1."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    vertices = torch.tensor(mesh.vertices * [0.15, 0.15, 0.6] + [0, 0, 0.5], dtype=dtype)
    upper = torch.sigmoid((vertices[:, 2] - 0.5) / 0.05)
    weights = torch.stack([1 - upper, 0.7 * upper, 0.3 * upper], 1)
    axis = torch.eye(3, dtype=dtype)
    faces = torch.tensor(mesh.faces)
    return BodyModel(
        name="ellipsoid", up=axis[2], front=-axis[1], left=axis[0],
        v_template=vertices, shapedirs=0.1 * vertices[..., None],
        J_template=torch.tensor([[0.0, 0, 0], [0, 0, 0.5], [0, 0, 0.8]], dtype=dtype),
        J_shapedirs=torch.tensor([[0.0, 0, 0], [0, 0, 0.05], [0, 0, 0.08]], dtype=dtype)[..., None],
        weights=weights, parents=torch.tensor([-1, 0, 1]), faces=faces, joint_names=("low", "high", "tip"),
        interior=torch.zeros(len(faces), dtype=torch.bool),
        keypoint_rows=torch.arange(1), keypoint_columns=torch.zeros(1, dtype=torch.long),
        keypoint_values=torch.ones(1, dtype=dtype), keypoint_valid=torch.arange(COUNT) == 0,
        canonical_pose=torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0]], dtype=dtype), active=torch.tensor([0, 1]),
        stiffness=torch.ones(3, dtype=dtype),
    )  # fmt: skip


def motion(frames: int = 4, dtype: torch.dtype = torch.float32) -> BodyMotion:
    """The ellipsoid rocks and bends a little, in front of a :func:`camera`; it never shows its back."""
    t = torch.linspace(-1, 1, frames, dtype=dtype)
    pose = torch.zeros(frames, 3, 3, dtype=dtype)
    pose[:, 0, 2] = 0.2 * t
    pose[:, 1, 0] = 0.3 * t
    return BodyMotion(
        torch.tensor([0.3], dtype=dtype), pose, torch.zeros(frames, 3, dtype=dtype), torch.zeros(COUNT, 3, dtype=dtype)
    )


def camera(azimuth: float = 0.0, dtype: torch.dtype = torch.float32) -> Tensor:
    """T_cam_from_world (4, 4) at 3 m from the body's middle; azimuth 0 rad sees -y, the front."""
    c, s = math.cos(azimuth), math.sin(azimuth)
    R = torch.tensor([[c, s, 0], [0, 0, -1], [-s, c, 0]], dtype=dtype)
    T = torch.eye(4, dtype=dtype)
    T[:3, :3] = R
    T[:3, 3] = torch.tensor([0, 0.5, 3.0], dtype=dtype)
    return T


PINHOLE = Pinhole(fx=100.0, fy=100.0, cx=32.0, cy=32.0, width=64, height=64)
