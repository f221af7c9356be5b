"""Rotations in torch: matrices inside, axis-angle (radians) in files, quaternions w, x, y, z where a format demands."""

from __future__ import annotations

import torch
from torch import Tensor


def hat(v: Tensor) -> Tensor:
    """Cross-product matrix: (..., 3) -> (..., 3, 3)."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*v.shape[:-1], 3, 3)


def axis_angle_to_matrix(v: Tensor) -> Tensor:
    """Rodrigues' formula: (..., 3) radians -> (..., 3, 3); smooth at zero."""
    square = (v * v).sum(-1)[..., None, None]
    small = square < 1e-8
    safe = torch.where(small, torch.ones_like(square), square)
    angle = safe.sqrt()
    a = torch.where(small, 1 - square / 6, angle.sin() / angle)
    b = torch.where(small, 0.5 - square / 24, (1 - angle.cos()) / safe)
    K = hat(v)
    return torch.eye(3, dtype=v.dtype, device=v.device) + a * K + b * (K @ K)


def matrix_to_quaternion(R: Tensor) -> Tensor:
    """(..., 3, 3) -> unit quaternion (..., 4) w, x, y, z with w >= 0; stable for every angle."""
    m = R.flatten(-2)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m.unbind(-1)
    # Each row is 4 q_i q; the row of the largest component is the well-conditioned one.
    rows = torch.stack(
        [
            torch.stack([1 + m00 + m11 + m22, m21 - m12, m02 - m20, m10 - m01], -1),
            torch.stack([m21 - m12, 1 + m00 - m11 - m22, m10 + m01, m02 + m20], -1),
            torch.stack([m02 - m20, m10 + m01, 1 - m00 + m11 - m22, m12 + m21], -1),
            torch.stack([m10 - m01, m20 + m02, m21 + m12, 1 - m00 - m11 + m22], -1),
        ],
        -2,
    )
    best = torch.diagonal(rows, dim1=-2, dim2=-1).argmax(-1)
    q = torch.gather(rows, -2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    q = q / q.norm(dim=-1, keepdim=True)
    return torch.where(q[..., :1] < 0, -q, q)


def quaternion_to_matrix(q: Tensor) -> Tensor:
    """Quaternion (..., 4) w, x, y, z of any non-zero length -> (..., 3, 3)."""
    w, x, y, z = (q / q.norm(dim=-1, keepdim=True)).unbind(-1)
    return torch.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        -1,
    ).reshape(*q.shape[:-1], 3, 3)  # fmt: skip


def matrix_to_axis_angle(R: Tensor) -> Tensor:
    """(..., 3, 3) -> axis-angle (..., 3) radians with angle in [0, pi]."""
    q = matrix_to_quaternion(R)
    vector = q[..., 1:]
    length = vector.norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(length, q[..., :1])
    return torch.where(length < 1e-9, 2 * vector, vector * angle / length.clamp_min(1e-12))


def orthonormal_frame(normal: Tensor) -> Tensor:
    """A rotation (..., 3, 3) whose third column is the unit vector ``normal`` (..., 3) (Duff et al. 2017)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0, torch.ones_like(z), -torch.ones_like(z))
    a = -1 / (sign + z)
    b = x * y * a
    u = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    v = torch.stack([b, sign + y * y * a, -y], -1)
    return torch.stack([u, v, normal], -1)
