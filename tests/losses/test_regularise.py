"""Regularisers on shapes whose answer is known, and gradients in float64."""

import math

import torch

from soar.losses.normal import normalise
from soar.losses.regularise import (
    curvature,
    depth_normals,
    normal_depth,
    offset,
    offset_laplacian,
    scale_log,
    scale_mean,
)  # fmt: skip
from soar.raster import Pinhole

PINHOLE = Pinhole(fx=50.0, fy=60.0, cx=8.0, cy=7.0, width=16, height=14)


def plane(normal: list[float], distance: float = 2.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Depth (H, W) of the plane with this normal at ``distance`` on the axis, and the unit normal."""
    n = torch.nn.functional.normalize(torch.tensor(normal, dtype=torch.float64), dim=0)
    y, x = torch.meshgrid(torch.arange(14.0) + 0.5, torch.arange(16.0) + 0.5, indexing="ij")
    ray = torch.stack([(x - 8.0) / 50.0, (y - 7.0) / 60.0, torch.ones_like(x)]).double()
    return n[2] * distance / (ray * n[:, None, None]).sum(0), n


def test_depth_normals_of_a_plane() -> None:
    depth, n = plane([0.3, -0.2, -1.0])
    got = depth_normals(depth, torch.ones(14, 16, dtype=torch.bool), PINHOLE)
    torch.testing.assert_close(got[:, 1:-1, 1:-1], n[:, None, None].expand(3, 12, 14), atol=1e-6, rtol=0)


def test_depth_normals_face_the_camera_and_agree_with_the_four_cross_products() -> None:
    generator = torch.Generator().manual_seed(0)
    depth = 2 + 0.01 * torch.rand(14, 16, dtype=torch.float64, generator=generator)
    visible = torch.rand(14, 16, generator=generator) > 0.2
    got = depth_normals(depth, visible, PINHOLE)
    rows, columns = (torch.arange(14) + 0.5 - 7) / 60, (torch.arange(16) + 0.5 - 8) / 50
    points = torch.stack([depth * columns, depth * rows[:, None], depth], -1)
    for y in range(14):
        for x in range(16):
            if not visible[y, x]:
                assert got[:, y, x].abs().max() == 0
                continue
            around = []
            for v, u in ((y - 1, x), (y, x - 1), (y + 1, x), (y, x + 1)):
                inside = 0 <= v < 14 and 0 <= u < 16 and visible[v, u]
                around.append(points[v, u] - points[y, x] if inside else torch.zeros(3, dtype=torch.float64))
            up, left, down, right = around
            cross = torch.linalg.cross
            total = cross(up, left) + cross(right, up) + cross(down, right) + cross(left, down)
            if total.norm() > 1e-5:
                torch.testing.assert_close(got[:, y, x], total / total.norm(), atol=1e-3, rtol=0)
                assert got[2, y, x] < 0


def test_normal_depth_is_zero_where_they_agree() -> None:
    depth, n = plane([0.3, -0.2, -1.0])
    alpha = torch.full((14, 16), 0.9, dtype=torch.float64)
    normals = (0.9 * n)[:, None, None].expand(3, 14, 16)
    assert float(normal_depth(normals, 0.9 * depth, alpha, PINHOLE)) < 1e-6
    assert float(normal_depth(-normals, 0.9 * depth, alpha, PINHOLE)) > 1.9
    assert float(normal_depth(normals, depth, 0 * alpha, PINHOLE)) == 0


def test_curvature_of_flat_and_folded() -> None:
    alpha = torch.ones(6, 8, dtype=torch.float64)
    normals = torch.zeros(3, 6, 8, dtype=torch.float64)
    normals[2] = -1
    assert float(curvature(normals, alpha)) < 1e-6
    angle = 0.3
    normals[0, :, 4:], normals[2, :, 4:] = math.sin(angle), -math.cos(angle)
    # The two columns at the fold each see the step once, in x and in z.
    step = math.sin(angle) + 1 - math.cos(angle)
    assert math.isclose(float(curvature(normals, alpha)), 2 * step / 8, rel_tol=1e-6)


def test_offset_and_its_laplacian() -> None:
    rest = torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ring = torch.tensor([[1, 2], [0, 2], [0, 1], [4, 0], [3, 0]])
    moved = rest + torch.tensor([0.003, 0.004, 0.0], dtype=torch.float64)
    assert math.isclose(float(offset(moved, rest)), 0.005, rel_tol=1e-3)
    assert float(offset_laplacian(moved, rest, ring)) < 1e-20
    moved = rest.clone()
    moved[0, 0] += 0.1
    # Itself by 0.1, and its four followers by half of that.
    assert math.isclose(float(offset_laplacian(moved, rest, ring)), (0.1**2 + 4 * 0.05**2) / 5, rel_tol=1e-6)


def test_scales() -> None:
    s, start = torch.tensor([0.01, 0.02]), torch.tensor([0.01, 0.01])
    assert math.isclose(float(scale_mean(s)), 0.015, rel_tol=1e-6)
    assert math.isclose(float(scale_log(s, start)), math.log(2) ** 2 / 2, rel_tol=1e-5)


def test_gradients() -> None:
    generator = torch.Generator().manual_seed(1)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=generator)

    pinhole = Pinhole(50.0, 60.0, 1.5, 1.5, 3, 3)
    normals = normalise(random(3, 3, 3) - 0.5).requires_grad_()
    depth = (2 + 0.05 * random(3, 3)).requires_grad_()
    alpha = torch.full((3, 3), 0.9, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda n, d: normal_depth(n, d, alpha, pinhole), (normals, depth))
    assert torch.autograd.gradcheck(lambda n: curvature(n, alpha), (normals,))
    rest, ring = random(3, 3), torch.tensor([[1, 2], [0, 2], [0, 1]])
    moved = (rest + 0.1 * random(3, 3)).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: offset(p, rest), (moved,))
    assert torch.autograd.gradcheck(lambda p: offset_laplacian(p, rest, ring), (moved,))
    scales = (0.01 + random(3)).requires_grad_()
    assert torch.autograd.gradcheck(lambda s: scale_log(s, torch.ones(3, dtype=torch.float64)), (scales,))
