from __future__ import annotations

import math

import pytest
import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix, rotation_matrix_to_quaternion

from soar.geometry import rotations as r


def vectors() -> torch.Tensor:
    """Axis-angle vectors of every kind: zero, tiny, ordinary, just under and at pi."""
    v = torch.nn.functional.normalize(
        torch.randn(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    angles = torch.tensor([0.0, 1e-9, 1e-5, 0.3, 1.5, 3.0, math.pi - 1e-6, math.pi], dtype=torch.float64).repeat(5)
    return v * angles[:, None]


def test_matrices_are_rotations_and_match_the_exponential() -> None:
    v = vectors()
    R = r.axis_angle_to_matrix(v)
    assert torch.allclose(R @ R.mT, torch.eye(3, dtype=R.dtype).expand_as(R), atol=1e-12)
    assert torch.allclose(R, torch.linalg.matrix_exp(r.hat(v)), atol=1e-9)


@pytest.mark.parametrize(
    ("there", "back"),
    [(r.matrix_to_quaternion, r.quaternion_to_matrix), (r.matrix_to_axis_angle, r.axis_angle_to_matrix)],
)
def test_round_trips(there, back) -> None:
    R = r.axis_angle_to_matrix(vectors())
    assert torch.allclose(back(there(R)), R, atol=1e-7)


def test_agrees_with_kornia_where_it_is_smooth() -> None:
    v = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    R = r.axis_angle_to_matrix(v)
    assert torch.allclose(R, axis_angle_to_rotation_matrix(v), atol=1e-6)
    theirs = rotation_matrix_to_quaternion(R)
    assert torch.allclose(r.matrix_to_quaternion(R), theirs * theirs[:, :1].sign(), atol=1e-6)


def test_quaternion_order_is_wxyz() -> None:
    q = r.matrix_to_quaternion(r.axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.pi / 2])))
    assert torch.allclose(q, torch.tensor([math.sqrt(0.5), 0, 0, math.sqrt(0.5)]), atol=1e-6)


def test_axis_angle_is_differentiable_at_zero() -> None:
    v = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(r.axis_angle_to_matrix, (v,))
    w = torch.randn(3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(r.axis_angle_to_matrix, (w,))


def test_frames_have_the_normal_as_third_column() -> None:
    n = torch.nn.functional.normalize(torch.randn(200, 3, dtype=torch.float64), dim=-1)
    n[0], n[1] = torch.tensor([0.0, 0, 1]), torch.tensor([0.0, 0, -1])
    R = r.orthonormal_frame(n)
    assert torch.allclose(R[..., 2], n)
    assert torch.allclose(R @ R.mT, torch.eye(3, dtype=R.dtype).expand_as(R), atol=1e-12)
    assert torch.allclose(torch.linalg.det(R), torch.ones(200, dtype=R.dtype))
