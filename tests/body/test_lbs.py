"""Skinning against loops over its definition, and the collapsed skeleton against skinning."""

import dataclasses

import numpy as np
import pytest
import torch

from soar.body import lbs
from soar.body.openpose import COUNT
from soar.body.skeleton import collapse
from soar.geometry.rotations import axis_angle_to_matrix
from tests.body import stickman


@pytest.fixture
def model():
    return stickman.body()


def blended(model, seed=0):
    """The model with smooth skin weights, so that blending matters."""
    generator = torch.Generator().manual_seed(seed)
    extra = torch.rand(model.weights.shape, generator=generator, dtype=torch.float64) ** 8
    weights = model.weights + 0.5 * extra
    return dataclasses.replace(model, weights=weights / weights.sum(1, keepdim=True))


def random_pose(model, frames=3, seed=1):
    generator = torch.Generator().manual_seed(seed)
    pose = 0.7 * torch.randn(frames, len(model.joint_names), 3, generator=generator, dtype=torch.float64)
    return axis_angle_to_matrix(pose), torch.randn(frames, 3, generator=generator, dtype=torch.float64)


def brute_force(model, betas, rotations, translation):
    """Vertices (V, 3) of one frame by recursion over 4x4 matrices."""
    rest = (model.v_template + (model.shapedirs * betas).sum(-1)).numpy()
    joints = (model.J_template + (model.J_shapedirs * betas).sum(-1)).numpy()
    if model.posedirs is not None:
        feature = (rotations[1:] - torch.eye(3, dtype=torch.float64)).reshape(-1)
        rest = rest + (model.posedirs * feature).sum(-1).numpy()
    world = []
    for j, parent in enumerate(model.parents.tolist()):
        local = np.eye(4)
        local[:3, :3] = rotations[j]
        local[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0)
        world.append(world[parent] @ local if parent >= 0 else local)
    out = np.zeros_like(rest)
    for v in range(len(rest)):
        for j in range(len(joints)):
            out[v] += float(model.weights[v, j]) * (world[j] @ np.append(rest[v] - joints[j], 1))[:3]
    return out + translation.numpy()


def test_matches_brute_force(model):
    model = blended(model)
    some = torch.arange(0, len(model.v_template), 97)
    small = dataclasses.replace(
        model, v_template=model.v_template[some], shapedirs=model.shapedirs[some], weights=model.weights[some],
        faces=model.faces[:1] * 0, interior=model.interior[:1],
        posedirs=1e-2 * torch.randn(len(some), 3, 9 * (len(model.parents) - 1), dtype=torch.float64,
                                    generator=torch.Generator().manual_seed(5)),
    )  # fmt: skip
    rotations, translation = random_pose(small)
    betas = torch.tensor([0.7, -0.4], dtype=torch.float64)
    got = lbs.pose_vertices(small, betas, rotations, translation)
    for t in range(3):
        np.testing.assert_allclose(got[t].numpy(), brute_force(small, betas, rotations[t], translation[t]), atol=1e-12)


def test_identity_is_rest_and_root_turns_in_place(model):
    betas = torch.tensor([0.3, 0.2], dtype=torch.float64)
    eye = torch.eye(3, dtype=torch.float64).repeat(len(model.joint_names), 1, 1)
    torch.testing.assert_close(
        lbs.pose_vertices(model, betas, eye, torch.zeros(3, dtype=torch.float64)), lbs.rest_vertices(model, betas)
    )
    eye[0] = axis_angle_to_matrix(torch.tensor([0.3, 1.0, -2.0], dtype=torch.float64))
    A = lbs.joint_transforms(model, betas, eye)
    root = lbs.rest_joints(model, betas)[0]
    torch.testing.assert_close(A[0, :, :3] @ root + A[0, :, 3], root)


def test_leading_dimensions(model):
    rotations, translation = random_pose(model, 6)
    betas = torch.zeros(2, dtype=torch.float64)
    flat = lbs.pose_vertices(model, betas, rotations, translation)
    nested = lbs.pose_vertices(model, betas, rotations.unflatten(0, (2, 3)), translation.unflatten(0, (2, 3)))
    assert nested.shape == (2, 3, len(model.v_template), 3)
    torch.testing.assert_close(nested.flatten(0, 1), flat)


def test_gradients(model):
    betas = torch.tensor([0.1, 0.2], dtype=torch.float64, requires_grad=True)
    pose = (0.3 * torch.randn(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))).requires_grad_()
    parents = torch.tensor([-1, 0, 1, 1])

    def transforms(betas, pose):
        joints = model.J_template[:4] + model.J_shapedirs[:4] @ betas
        return lbs.chain(parents, joints, axis_angle_to_matrix(pose))

    assert torch.autograd.gradcheck(transforms, (betas, pose))


def test_keypoints_are_regressed_posed_points(model):
    model = blended(model)
    rotations, translation = random_pose(model)
    betas = torch.tensor([0.5, -0.5], dtype=torch.float64)
    vertices = lbs.pose_vertices(model, betas, rotations, translation)
    A = lbs.joint_transforms(model, betas, rotations)
    joints = (A[..., :3] @ lbs.rest_joints(model, betas)[..., None]).squeeze(-1) + A[..., 3] + translation[:, None]
    expected = model.regressor().to_dense() @ torch.cat([vertices, joints], 1)
    valid = model.keypoint_valid
    got = lbs.keypoints(model, betas, rotations, translation)
    torch.testing.assert_close(got[:, valid], expected[:, valid])


def test_collapsed_skeleton_is_exact(model):
    """Passive joints ride on their ancestors: the same keypoints, with shape and offsets, to rounding."""
    model = blended(model)
    skeleton = collapse(model)
    assert len(skeleton.active) == len(model.joint_names) - 2
    full, translation = random_pose(model)
    rotations = full[:, skeleton.active]
    betas = torch.tensor([0.4, 0.9], dtype=torch.float64)
    offsets = 0.02 * torch.randn(COUNT, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    got = skeleton.keypoints(skeleton.transforms(betas, rotations), betas, translation, offsets)
    expanded = skeleton.full_rotations(rotations, len(model.joint_names))
    expected = lbs.keypoints(model, betas, expanded, translation, offsets)
    torch.testing.assert_close(got, expected, atol=1e-12, rtol=0)
    carried = lbs.skin(
        skeleton.transforms(betas, rotations), skeleton.carried(model.weights), lbs.rest_vertices(model, betas)
    )
    vertices = lbs.pose_vertices(model, betas, expanded, translation)
    torch.testing.assert_close(carried + translation[:, None], vertices, atol=1e-12, rtol=0)


def test_height_is_linear(model):
    mean, slope = lbs.height(model)
    betas = torch.tensor([0.5, 0.0], dtype=torch.float64)
    tall = lbs.rest_vertices(model, betas)[:, 2]
    assert float(mean + slope @ betas) == pytest.approx(float(tall.max() - tall.min()))
