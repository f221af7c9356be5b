"""How good a fit is: reprojection, overlap with the masks, jitter, and distance to another fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from soar.body import lbs
from soar.body.motion import BodyMotion
from soar.body.observations import Observations
from soar.body.openpose import INDEX
from soar.body.record import BodyModel
from soar.geometry.cameras import Camera
from soar.raster import Pinhole, rasterise_mesh


@torch.no_grad()
def motion_keypoints(model: BodyModel, motion: BodyMotion, offsets: bool = True) -> np.ndarray:
    """(T, 137, 3) world keypoints, metres; NaN for points the body lacks."""
    shift = motion.keypoint_offsets if offsets else None
    points = lbs.keypoints(model, motion.betas, motion.rotations, motion.translation, shift).numpy().astype(np.float64)
    points[:, ~model.keypoint_valid.numpy()] = np.nan
    return points


@torch.no_grad()
def frame_vertices(model: BodyModel, motion: BodyMotion, t: int) -> np.ndarray:
    """(V, 3) world vertices of frame ``t``, metres."""
    return lbs.pose_vertices(model, motion.betas, motion.rotations[t], motion.translation[t]).numpy()


def reprojection(seen: Observations, points: np.ndarray) -> np.ndarray:
    """(C, T, 137) reprojection error in pixels of world keypoints (T, 137, 3); NaN where nothing was seen."""
    projected = np.stack([camera.project(points) for camera in seen.cameras])
    error = np.linalg.norm(projected - seen.points, axis=-1)
    return np.where(seen.confidence > 0, error, np.nan)


def body_mask(camera: Camera, vertices: np.ndarray, model: BodyModel) -> np.ndarray:
    """(H, W) bool: where the body at world ``vertices`` (V, 3) covers the camera's image."""
    pinhole = Pinhole.from_K(camera.K, camera.width, camera.height)
    local = torch.from_numpy(camera.to_camera(vertices).astype(np.float32))
    return np.asarray(rasterise_mesh(local, model.faces, pinhole, "front").face) >= 0


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two bool images; NaN when both are empty."""
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else float("nan")


def mask_overlap(
    model: BodyModel,
    motion: BodyMotion,
    camera: Camera,
    masks: Sequence[np.ndarray],
    frames: Sequence[int],
    threshold: float,
) -> np.ndarray:
    """(len(frames),) intersection over union of body and mask (uint8, full size) in one camera."""
    return np.array([
        overlap(body_mask(camera, frame_vertices(model, motion, t), model), masks[t] >= 255 * threshold) for t in frames
    ])  # fmt: skip


def stature(model: BodyModel, betas: torch.Tensor) -> float:
    """Height of the rest body in metres, as the fit's stature term measures it."""
    mean, slope = lbs.height(model)
    return float(mean + slope @ betas)


def jitter(points: np.ndarray) -> float:
    """Mean length of the second difference of points (T, K, 3) in metres: cm per frame squared; NaN below 3 frames."""
    if len(points) < 3:
        return float("nan")
    return float(100 * np.nanmean(np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1)))


def turned_away(model: BodyModel, motion: BodyMotion, camera: Camera) -> np.ndarray:
    """(T, 2) angle on the ground, degrees, between where hips and shoulders face and where the camera is.

    Both face at right angles to the line between their joints; beyond 90 degrees the camera sees the back.
    """
    points, up = motion_keypoints(model, motion), model.up.numpy().astype(np.float64)
    angles = []
    for part in ("hip", "shoulder"):
        left, right = (points[:, INDEX[f"{side}_{part}"]] for side in ("left", "right"))
        facing, towards = np.cross(left - right, up), camera.centre - (left + right) / 2
        across = np.cross(facing, towards) @ up
        angles.append(
            np.degrees(np.abs(np.arctan2(across, (facing * (towards - (towards @ up)[:, None] * up)).sum(1))))
        )
    return np.stack(angles, 1)


def aligned_error(points: np.ndarray, reference: np.ndarray, root: int) -> np.ndarray:
    """(T, K) distance in metres of points (T, K, 3) to the reference after bringing keypoint ``root`` together."""
    return np.linalg.norm((points - points[:, root, None]) - (reference - reference[:, root, None]), axis=-1)


def procrustes_error(points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(T, K) distance in metres after the best similarity transform of each frame (Umeyama 1991)."""
    a, b = points - points.mean(1, keepdims=True), reference - reference.mean(1, keepdims=True)
    U, s, Vt = np.linalg.svd(np.einsum("tki,tkj->tij", a, b))
    flip = np.ones_like(s)
    flip[:, -1] = np.sign(np.linalg.det(U @ Vt))
    R = (U * flip[:, None]) @ Vt
    scale = (s * flip).sum(1) / (a**2).sum((1, 2)).clip(1e-12)
    return np.linalg.norm(scale[:, None, None] * a @ R - b, axis=-1)
