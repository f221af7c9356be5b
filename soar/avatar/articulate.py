"""Linear blend skinning of surfels by a moving body (paper, section 3.1)."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from soar.avatar.surfels import canonical_vertices, nearest
from soar.body.lbs import joint_transforms
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.geometry.rotations import axis_angle_to_matrix

DISTANCE_RANGE = (1e-4, 1.0)
"""Clamp, in metres, of the distances whose inverses weight the neighbours."""


@dataclasses.dataclass(frozen=True)
class Articulation:
    """A body's motion as seen from the canonical pose.

    Bones that never move against their parent share its transform exactly; their weight columns are summed, so B is
    the number of groups of bones that do move, usually a fifth of the skeleton.

    Attributes:
        vertices: (V, 3) canonical body vertices, metres.
        weights: (V, B) skinning weights, rows sum to 1.
        transforms: (T, B, 3, 4) world from canonical.
    """

    vertices: Tensor
    weights: Tensor
    transforms: Tensor

    @staticmethod
    def of(body: BodyModel, motion: BodyMotion) -> Articulation:
        """Combine a body model and T frames of its motion."""
        canonical = _square(joint_transforms(body, motion.betas, axis_angle_to_matrix(body.canonical_pose)))
        posed = _square(joint_transforms(body, motion.betas, motion.rotations))
        transforms = (posed @ torch.linalg.inv(canonical))[..., :3, :]
        transforms[..., 3] += motion.translation[:, None]
        group, movers = _groups(transforms, body.parents.tolist())
        weights = body.weights.new_zeros(len(body.weights), len(movers)).index_add_(1, group, body.weights)
        return Articulation(canonical_vertices(body, motion.betas), weights, transforms[:, movers])

    def blend(self, positions: Tensor, neighbours: int) -> Tensor:
        """Skinning weights (N, B) of canonical ``positions`` (N, 3): the nearest vertices', by inverse distance.

        No gradient flows into the positions: the weights follow the surfels, they do not pull them.
        """
        distances, indices = nearest(self.vertices, positions, neighbours)
        inverse = distances.clamp(*DISTANCE_RANGE).reciprocal()
        share = inverse / inverse.sum(1, keepdim=True)
        return embedding_bag(indices, self.weights, per_sample_weights=share, mode="sum")

    def in_camera(self, frame: int, T_cam_from_world: Tensor) -> Tensor:
        """Transforms (B, 3, 4) of one frame, camera from canonical."""
        return T_cam_from_world[:3, :3] @ self.transforms[frame] + pad(T_cam_from_world[:3, 3:], (3, 0))


def pose(positions: Tensor, normals: Tensor, blend: Tensor, transforms: Tensor) -> tuple[Tensor, Tensor]:
    """Move surfels from canonical space into the space the transforms lead to.

    Args:
        positions: (N, 3) canonical, metres.
        normals: (N, 3) canonical; any length.
        blend: (N, B) skinning weights.
        transforms: (B, 3, 4).

    Returns:
        positions (N, 3), and unit normals (N, 3): a blend of rotations is not a rotation, so they are renormalised.
    """
    matrices = (blend @ transforms.flatten(1)).unflatten(1, (3, 4))
    linear = matrices[..., :3]
    moved = torch.matmul(linear, positions[..., None])[..., 0] + matrices[..., 3]
    turned = torch.matmul(linear, normals[..., None])[..., 0]
    return moved, unit(turned)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (N, 3) scaled to length 1; a zero vector stays zero, with a finite gradient."""
    return vectors * (vectors.square().sum(-1, keepdim=True) + 1e-16).rsqrt()


def _square(transforms: Tensor) -> Tensor:
    """(..., 3, 4) -> (..., 4, 4)."""
    last = transforms.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*transforms.shape[:-2], 1, 4)
    return torch.cat([transforms, last], -2)


def _groups(transforms: Tensor, parents: list[int]) -> tuple[Tensor, list[int]]:
    """Group of each joint (J,), and the joint that stands for each group; parents come before children."""
    group: list[int] = []
    movers: list[int] = []
    for joint, parent in enumerate(parents):
        if parent >= 0 and (transforms[:, joint] - transforms[:, parent]).abs().max() < 1e-5:
            group.append(group[parent])
        else:
            group.append(len(movers))
            movers.append(joint)
    return torch.tensor(group, device=transforms.device), movers
