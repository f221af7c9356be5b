"""The body reduced to the joints a fit turns: identical keypoints, no vertex touched.

A joint that stays at identity moves rigidly with its nearest turned ancestor, so its skin weights can be added to that
ancestor's. A keypoint regressed from vertices is then ``sum_a G_a P_ka + w_ka t_a`` with ``P_ka = sum_v R_kv W_va v``
linear in the betas, computed once.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from soar.body.lbs import chain
from soar.body.record import BodyModel


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """A active joints, K keypoints, B betas.

    Attributes:
        parents: (A,) long, -1 for the root.
        joints, joint_dirs: (A, 3) and (A, 3, B), metres.
        points, point_dirs: (K, A, 3) and (K, A, 3, B): each joint's share of each keypoint's rest position.
        point_weights: (K, A) each joint's share of the keypoint; rows sum to one, or to zero for an invalid keypoint.
        owner: (J,) the active joint that carries each joint of the full body.
        stiffness: (A,).
        active: (A,) indices in the full body.
    """

    parents: Tensor
    joints: Tensor
    joint_dirs: Tensor
    points: Tensor
    point_dirs: Tensor
    point_weights: Tensor
    owner: Tensor
    stiffness: Tensor
    active: Tensor

    def transforms(self, betas: Tensor, rotations: Tensor) -> Tensor:
        """Skinning transforms (..., A, 3, 4) of local rotations (..., A, 3, 3)."""
        return chain(self.parents, self.joints + self.joint_dirs @ betas, rotations)

    def keypoints(self, transforms: Tensor, betas: Tensor, translation: Tensor, offsets: Tensor) -> Tensor:
        """World keypoints (..., K, 3) at ``translation`` (..., 3) with rest-space ``offsets`` (K, 3)."""
        w = self.point_weights[..., None]
        shares = torch.cat([self.points + self.point_dirs @ betas + w * offsets[:, None], w], -1).flatten(1)
        columns = transforms.transpose(-2, -3).flatten(-2)
        return (columns @ shares.T).transpose(-1, -2) + translation[..., None, :]

    def full_rotations(self, rotations: Tensor, joints: int) -> Tensor:
        """Local rotations (..., A, 3, 3) as (..., J, 3, 3) of the full body, identity elsewhere."""
        eye = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
        out = eye.expand(*rotations.shape[:-3], joints, 3, 3).clone()
        out[..., self.active, :, :] = rotations
        return out

    def carried(self, weights: Tensor) -> Tensor:
        """Skin weights (N, J) of the full body added up over the joints that carry them: (N, A)."""
        return weights.new_zeros(len(weights), len(self.active)).index_add(1, self.owner, weights)


def collapse(model: BodyModel) -> Skeleton:
    """The skeleton of the model's active joints.

    Exact for a body without pose blend shapes; with them, keypoints leave out the blend shapes' few millimetres.
    """
    parents, active = model.parents.tolist(), model.active.tolist()
    place = {joint: a for a, joint in enumerate(active)}
    owner: list[int] = []
    for joint, parent in enumerate(parents):
        owner.append(place[joint] if joint in place else owner[parent])
    carriers = torch.tensor(owner, device=model.parents.device)
    up = torch.tensor([-1 if parents[j] < 0 else owner[parents[j]] for j in active], device=carriers.device)

    eye = torch.eye(len(parents), dtype=model.weights.dtype, device=model.weights.device)
    weights = torch.cat([model.weights, eye])
    rest = torch.cat([model.v_template, model.J_template])
    dirs = torch.cat([model.shapedirs, model.J_shapedirs])
    B = dirs.shape[-1]
    regressor = model.regressor()
    rows, columns = regressor.indices()
    K, A = regressor.shape[0], len(active)
    per_joint = weights.new_zeros(len(columns), A).index_add(1, carriers, weights[columns])
    share = regressor.values()[:, None] * per_joint
    values = torch.cat(
        [rest[columns][..., None], dirs[columns], torch.ones_like(rest[columns, :1, None].expand(-1, 3, 1))], -1
    )
    total = share.new_zeros(K, A, 3, B + 2)
    total.index_add_(0, rows, share[..., None, None] * values[:, None])
    return Skeleton(
        parents=up,
        joints=model.J_template[model.active],
        joint_dirs=model.J_shapedirs[model.active],
        points=total[..., 0],
        point_dirs=total[..., 1:-1],
        point_weights=total[..., 0, -1],
        owner=carriers,
        stiffness=model.stiffness[model.active],
        active=model.active,
    )
