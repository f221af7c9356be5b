"""First poses of a clip from points in space: triangulated ones, or one camera's metric landmarks."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from soar.body.observations import Observations
from soar.body.openpose import BODY, COUNT, INDEX
from soar.body.record import BodyModel
from soar.body.robust import geman_mcclure, minimise
from soar.body.skeleton import Skeleton
from soar.errors import SubjectError
from soar.geometry.cameras import Camera
from soar.geometry.rotations import axis_angle_to_matrix

TORSO = tuple(INDEX[n] for n in ("left_shoulder", "right_shoulder", "left_hip", "right_hip"))


@dataclasses.dataclass(frozen=True)
class InitialSettings:
    """Settings of :func:`pose_from_points`.

    Attributes:
        sigma_m: Geman-McClure scale of distances to the points, metres.
        pose_prior: weight of squared joint angles (times stiffness), against mean squared distance in centimetres.
        shape_prior: weight of squared betas, likewise.
        iterations: L-BFGS iterations.
    """

    sigma_m: float
    pose_prior: float
    shape_prior: float
    iterations: int


@dataclasses.dataclass(frozen=True)
class Poses:
    """A shape and T poses over the active joints: where a fit starts and ends.

    Attributes:
        betas: (B,).
        rotations: (T, A, 3, 3) local rotations.
        translation: (T, 3) metres.
        offsets: (137, 3) rest-space keypoint offsets, metres.
    """

    betas: Tensor
    rotations: Tensor
    translation: Tensor
    offsets: Tensor


def points_from_world(camera: Camera, seen: Observations) -> np.ndarray:
    """Metric points of the first camera placed in space: (T, 137, 3) metres in the world; NaN beyond BODY_25.

    Each frame's translation is the linear least-squares solution of ``x (Z + tz) = X + tx`` over the confident points.

    Raises:
        SubjectError: no frame has metric points of what was seen.
    """
    body = slice(0, len(BODY))
    known = np.isfinite(seen.world[0]).all(-1)
    local, confidence = np.nan_to_num(seen.world[0]), np.where(known, seen.confidence[0, :, body], 0)
    rays = (np.concatenate([seen.points[0, :, body], np.ones((*confidence.shape, 1))], -1)) @ np.linalg.inv(camera.K).T
    # Two rows per point: [1 0 -x] t = x Z - X and [0 1 -y] t = y Z - Y, weighted by confidence.
    A = np.zeros((*confidence.shape, 2, 3))
    A[..., 0, 0] = A[..., 1, 1] = 1
    A[..., 2] = -rays[..., :2]
    b = rays[..., :2] * local[..., 2:] - local[..., :2]
    w = confidence[..., None, None]
    AtA = np.einsum("tkai,tkaj->tij", w * A, A)
    Atb = np.einsum("tkai,tka->ti", w * A, b)
    solvable = (confidence > 0).sum(1) >= 4
    if not solvable.any():
        raise SubjectError(
            f"camera {camera.name} has no metric landmarks to start a fit to one camera from",
            expected="at least one frame with 4 keypoints of the body whose metric landmarks are known",
            got=f"{len(seen)} frames, {int(known.any(1).sum())} of them with metric landmarks",
            cure="look at the pictures of the keypoint stage; more calibrated cameras need no metric landmarks",
        )
    out = np.full((len(seen), COUNT, 3), np.nan)
    t = np.linalg.solve(AtA[solvable], Atb[solvable][..., None])[..., 0]
    placed = local[solvable] + t[:, None]
    world = (placed - camera.t) @ camera.R
    out[solvable, body] = np.where(confidence[solvable][..., None] > 0, world, np.nan)
    return out


def torso_frames(model: BodyModel, X: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotation of the trunk, world from rest body, from shoulders and hips of X (T, 137, 3).

    A frame without them takes the nearest frame's.

    Raises:
        SubjectError: no frame has all four points.
    """
    sl, sr, hl, hr = (X[:, i] for i in TORSO)
    up = (sl + sr - hl - hr) / 2
    left = (sl - sr + hl - hr) / 2
    good = np.flatnonzero(
        np.isfinite(up).all(1) & np.isfinite(left).all(1) & (np.linalg.norm(np.nan_to_num(up), axis=1) > 1e-3)
    )
    if not len(good):
        raise SubjectError(
            "shoulders and hips are never all seen in one frame",
            expected="one frame with both shoulders and both hips, seen by two cameras, or by the only one",
            got="none",
            cure="choose a clip that shows the trunk, or lower body.min_confidence",
        )
    nearest = good[np.abs(np.arange(len(X))[:, None] - good).argmin(1)]
    u = up[nearest] / np.linalg.norm(up[nearest], axis=1, keepdims=True)
    side = left[nearest] - (left[nearest] * u).sum(1, keepdims=True) * u
    side /= np.linalg.norm(side, axis=1, keepdims=True).clip(1e-9)
    target = np.stack([side, np.cross(side, u), u], -1)
    source = torch.stack([model.left, torch.linalg.cross(model.left, model.up), model.up], -1).double().numpy()
    return target @ source.T


def pose_from_points(model: BodyModel, skeleton: Skeleton, X: np.ndarray, settings: InitialSettings) -> Poses:
    """Fit shape and poses to points in space.

    Args:
        model: the body.
        skeleton: its collapsed skeleton.
        X: (T, 137, 3) metres; NaN = unknown. Only BODY_25 is used.
        settings: robustness and priors.

    Raises:
        SubjectError: the trunk is never seen.
        NumericalError: the optimisation diverged.
    """
    like = model.v_template
    body = slice(0, len(BODY))
    known = np.isfinite(X[:, body]).all(-1) & model.keypoint_valid[body].numpy()
    target = torch.as_tensor(np.nan_to_num(X[:, body]), dtype=like.dtype)
    weight = torch.as_tensor(known, dtype=like.dtype)
    T, A = len(X), len(skeleton.active)
    base = torch.eye(3, dtype=like.dtype).repeat(T, A, 1, 1)
    base[:, 0] = torch.as_tensor(torso_frames(model, X), dtype=like.dtype)
    offsets = like.new_zeros(COUNT, 3)
    betas = like.new_zeros(model.shapedirs.shape[-1])
    rest = skeleton.keypoints(skeleton.transforms(betas, base), betas, like.new_zeros(T, 3), offsets)[:, body]
    count = weight.sum(1)
    seen = np.flatnonzero(known.sum(1) >= 4)
    shift = (weight[..., None] * (target - rest)).sum(1) / count.clamp_min(1)[:, None]
    # Frames without points start where their neighbours are.
    nearest = seen[np.abs(np.arange(T)[:, None] - seen).argmin(1)]
    translation = shift[torch.from_numpy(nearest)].clone()

    betas, translation = betas.requires_grad_(), translation.requires_grad_()
    turns = like.new_zeros(T, A, 3).requires_grad_()

    def terms() -> dict[str, Tensor]:
        points = skeleton.keypoints(
            skeleton.transforms(betas, base @ axis_angle_to_matrix(turns)), betas, translation, offsets
        )[:, body]
        square = 1e4 * ((points - target) ** 2).sum(-1)
        return {
            "points": (weight * geman_mcclure(square, 100 * settings.sigma_m)).sum() / weight.sum().clamp_min(1),
            "pose": settings.pose_prior * (skeleton.stiffness * (turns**2).sum(-1)).sum() / T,
            "shape": settings.shape_prior * (betas**2).sum(),
        }

    minimise(terms, [betas, turns, translation], steps=1, iterations=settings.iterations, what="the initial pose")
    return Poses(betas.detach(), (base @ axis_angle_to_matrix(turns)).detach(), translation.detach(), offsets)
