"""Linear blend skinning, one code path for every :class:`~soar.body.record.BodyModel`.

Loper et al., SMPL (2015), equations 2 to 10, with rest orientations equal to the world axes:
``G_j = G_parent R_j``, ``t_j = t_parent + G_parent (J_j - J_parent)``, and a vertex ``v = sum_j w_j A_j v_rest`` with
``A_j = [G_j | t_j - G_j J_j]``.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

from soar.body.record import BodyModel


def rest_vertices(model: BodyModel, betas: Tensor) -> Tensor:
    """Rest vertices (V, 3) in metres of shape ``betas`` (B,)."""
    return model.v_template + model.shapedirs @ betas


def rest_joints(model: BodyModel, betas: Tensor) -> Tensor:
    """Rest joints (J, 3) in metres of shape ``betas`` (B,)."""
    return model.J_template + model.J_shapedirs @ betas


def height(model: BodyModel) -> tuple[Tensor, Tensor]:
    """Stature as a linear function of the betas: the mean, metres, and its slope (B,); crown above soles at rest."""
    along = model.v_template @ model.up
    top, bottom = int(along.argmax()), int(along.argmin())
    return along[top] - along[bottom], model.up @ (model.shapedirs[top] - model.shapedirs[bottom])


def depth_levels(parents: Tensor) -> tuple[Tensor, ...]:
    """Joints (L_d,) of each depth d of the kinematic tree, the root first."""
    depth: list[int] = []
    for parent in parents.tolist():
        depth.append(0 if parent < 0 else depth[parent] + 1)
    depths = torch.tensor(depth, device=parents.device)
    return tuple(torch.nonzero(depths == d).squeeze(1) for d in range(max(depth) + 1))


def chain(parents: Tensor, joints: Tensor, rotations: Tensor) -> Tensor:
    """Skinning transforms of a kinematic tree, one batched product per depth.

    Args:
        parents: (J,) long, -1 for the root.
        joints: (J, 3) rest positions.
        rotations: (..., J, 3, 3) local rotations.

    Returns:
        (..., J, 3, 4): ``[G_j | t_j - G_j J_j]``. The root turns about its rest position.
    """
    levels = depth_levels(parents)
    G = rotations[..., levels[0], :, :]
    t = joints[levels[0]].expand(*G.shape[:-2], 3)
    turned, placed = [G], [t]
    for above, level in itertools.pairwise(levels):
        up = torch.searchsorted(above, parents[level])
        bone = joints[level] - joints[parents[level]]
        t = t[..., up, :] + (G[..., up, :, :] @ bone[..., None]).squeeze(-1)
        G = G[..., up, :, :] @ rotations[..., level, :, :]
        turned.append(G)
        placed.append(t)
    order = torch.argsort(torch.cat(levels))
    G, t = torch.cat(turned, -3)[..., order, :, :], torch.cat(placed, -2)[..., order, :]
    return torch.cat([G, (t - (G @ joints[..., None]).squeeze(-1))[..., None]], -1)


def joint_transforms(model: BodyModel, betas: Tensor, rotations: Tensor) -> Tensor:
    """Skinning transforms (..., J, 3, 4) of ``rotations`` (..., J, 3, 3) at shape ``betas`` (B,)."""
    return chain(model.parents, rest_joints(model, betas), rotations)


def skin(transforms: Tensor, weights: Tensor, points: Tensor) -> Tensor:
    """Blend transforms (..., J, 3, 4) by weights (N, J) and apply them to rest points (N, 3) or (..., N, 3)."""
    blend = (weights @ transforms.flatten(-2)).unflatten(-1, (3, 4))
    return (blend[..., :3] @ points[..., None]).squeeze(-1) + blend[..., 3]


def _posed_shape(model: BodyModel, betas: Tensor, rotations: Tensor) -> Tensor:
    """Rest vertices with pose blend shapes: (V, 3), or (..., V, 3) where the model has them."""
    shaped = rest_vertices(model, betas)
    if model.posedirs is None:
        return shaped
    feature = (rotations[..., 1:, :, :] - torch.eye(3, dtype=shaped.dtype, device=shaped.device)).flatten(-3)
    return shaped + torch.einsum("vxp,...p->...vx", model.posedirs, feature)


def pose_vertices(model: BodyModel, betas: Tensor, rotations: Tensor, translation: Tensor) -> Tensor:
    """World vertices.

    Args:
        model: the body.
        betas: (B,) shape.
        rotations: (..., J, 3, 3) local rotations.
        translation: (..., 3) metres.

    Returns:
        (..., V, 3) metres.
    """
    transforms = joint_transforms(model, betas, rotations)
    return skin(transforms, model.weights, _posed_shape(model, betas, rotations)) + translation[..., None, :]


def keypoints(
    model: BodyModel, betas: Tensor, rotations: Tensor, translation: Tensor, offsets: Tensor | None = None
) -> Tensor:
    """World keypoints (..., 137, 3); arguments as :func:`pose_vertices`, plus rest-space ``offsets`` (137, 3) metres.

    A regressed joint moves rigidly with that joint's own transform. Invalid keypoints come out at the translation.
    """
    transforms = joint_transforms(model, betas, rotations)
    shape = _posed_shape(model, betas, rotations)
    joints = rest_joints(model, betas)
    regressor = model.regressor()
    rest = torch.cat([shape, joints.expand(*shape.shape[:-2], *joints.shape)], -2)
    weights = torch.cat([model.weights, torch.eye(len(joints), dtype=shape.dtype, device=shape.device)])
    rows, columns = regressor.indices()
    points = skin(transforms, weights[columns], rest[..., columns, :])
    if offsets is not None:
        blend = (weights[columns] @ transforms[..., :3].flatten(-2)).unflatten(-1, (3, 3))
        points = points + (blend @ offsets[rows, :, None]).squeeze(-1)
    out = points.new_zeros(*points.shape[:-2], regressor.shape[0], 3)
    out = out.index_add(-2, rows, regressor.values()[:, None] * points)
    return out + translation[..., None, :]
