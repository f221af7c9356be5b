"""Skinning of surfels: agreement with the body's own, neighbours, merged bones, gradients."""

import pytest
import torch

from soar.avatar.articulate import Articulation, pose, unit
from soar.avatar.surfels import canonical_vertices, nearest
from soar.body.lbs import pose_vertices
from tests.avatar import toy


@pytest.fixture
def articulation() -> Articulation:
    return Articulation.of(toy.body(torch.float64), toy.motion(dtype=torch.float64))


def test_a_surfel_on_a_vertex_follows_the_body(articulation: Articulation) -> None:
    body, motion = toy.body(torch.float64), toy.motion(dtype=torch.float64)
    vertices = canonical_vertices(body, motion.betas)
    blend = articulation.blend(vertices, 1)
    for frame in range(len(motion)):
        truth = pose_vertices(body, motion.betas, motion.rotations[frame], motion.translation[frame])
        moved, _ = pose(vertices, vertices, blend, articulation.in_camera(frame, torch.eye(4, dtype=torch.float64)))
        # The canonical transform is blended before it is inverted on the body, after it here: exact on one bone only.
        rigid = articulation.weights.max(1).values > 0.999
        assert rigid.sum() > 10
        torch.testing.assert_close(moved[rigid], truth[rigid], atol=1e-3, rtol=0)
        assert (moved - truth).norm(dim=-1).max() < 0.02


def test_bones_that_ride_along_are_merged(articulation: Articulation) -> None:
    assert articulation.weights.shape[1] == 2
    torch.testing.assert_close(articulation.weights.sum(1), torch.ones(len(articulation.vertices), dtype=torch.float64))


def test_blend_agrees_with_brute_force(articulation: Articulation) -> None:
    points = articulation.vertices[::7] + 0.01
    got = articulation.blend(points, 5)
    for point, row in zip(points, got, strict=True):
        distance = (articulation.vertices - point).norm(dim=-1)
        index = distance.argsort()[:5]
        share = 1 / distance[index].clamp(1e-4, 1.0)
        torch.testing.assert_close(row, (share / share.sum()) @ articulation.weights[index])


def test_nearest_is_sorted_and_exact() -> None:
    generator = torch.Generator().manual_seed(1)
    points, queries = torch.rand(50, 3, generator=generator), torch.rand(7, 3, generator=generator)
    distances, indices = nearest(points, queries, 4)
    truth = torch.cdist(queries, points).sort(1)
    torch.testing.assert_close(distances, truth.values[:, :4])
    assert torch.equal(indices, truth.indices[:, :4])
    assert nearest(points, queries, 1)[1].shape == (7, 1)


def test_the_camera_is_applied_after_the_world(articulation: Articulation) -> None:
    T = toy.camera(0.7, torch.float64)
    points = articulation.vertices[:5]
    blend = articulation.blend(points, 3)
    world, normal = pose(points, points, blend, articulation.in_camera(1, torch.eye(4, dtype=torch.float64)))
    seen, turned = pose(points, points, blend, articulation.in_camera(1, T))
    torch.testing.assert_close(seen, world @ T[:3, :3].T + T[:3, 3])
    torch.testing.assert_close(turned, normal @ T[:3, :3].T)


def test_normals_come_out_unit_and_weights_carry_no_gradient(articulation: Articulation) -> None:
    positions = (articulation.vertices[:20] + 0.001).requires_grad_()
    blend = articulation.blend(positions, 5)
    assert not blend.requires_grad
    _, normals = pose(positions, 3 * positions, blend, articulation.in_camera(0, torch.eye(4, dtype=torch.float64)))
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(20, dtype=torch.float64))


def test_pose_gradient(articulation: Articulation) -> None:
    points = articulation.vertices[40:43].clone().requires_grad_()
    normals = torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    blend, transforms = articulation.blend(points, 4), articulation.in_camera(2, toy.camera(dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda p, n: pose(p, n, blend, transforms), (points, normals))


def test_unit_of_zero_is_finite() -> None:
    v = torch.zeros(1, 3, requires_grad=True)
    unit(v).sum().backward()
    assert torch.isfinite(v.grad).all()
    assert torch.equal(unit(v).detach(), torch.zeros(1, 3))
