"""Keypoints of a body that the dataset knows."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.body import measure
from soar.body.motion import BodyMotion
from soar.body.openpose import BODY, INDEX
from soar.body.record import BodyModel
from soar.geometry.cameras import Camera
from soar.perception.keypoints import Keypoints, TrackReport
from soar.perception.lift import OWN, body_region, landmarks


def projected(model: BodyModel, motion: BodyMotion, camera: Camera) -> tuple[Keypoints, TrackReport]:
    """The keypoints of a known body in one camera, in the form of an estimate.

    Confidence is 1 in the picture, also behind other limbs, and 0 beyond it and for points the body lacks. The metric
    landmarks are those that keypoints of the body are made of; the others are zero.
    """
    points = measure.motion_keypoints(model, motion)
    local, pixels = camera.to_camera(points), camera.project(points)
    # Comparisons with NaN are false: points the body lacks are in no picture.
    inside = (local[..., 2] > 0) & ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(-1)
    keypoints = np.where(inside[..., None], np.concatenate([pixels, np.ones_like(pixels[..., :1])], -1), 0)
    count = len(points)
    shown = np.any(inside[:, : len(BODY)], axis=1)
    record = Keypoints(
        keypoints.astype(np.float32),
        _landmarks(local[:, : len(BODY)]).astype(np.float32),
        np.stack([_region(p) for p in pixels[:, : len(BODY)]]) * shown[:, None],
        shown.astype(np.float32),
        np.zeros((count, len(BODY)), np.float32),
    )
    remark = "The keypoints are those of the dataset's own body."
    return record, TrackReport(0, 0.0, 0, np.zeros((count, 3), bool), (remark,))


def _landmarks(body: np.ndarray) -> np.ndarray:
    """(T, 33, 3) metric landmarks of body keypoints (T, 25, 3) in the camera's axes, about the middle of the hips."""
    centred = np.nan_to_num(body - body[:, INDEX["mid_hip"], None])
    return landmarks(centred) * OWN[:, None]


def _region(body: np.ndarray) -> np.ndarray:
    """(4,) centre, side and rotation of the region round body keypoints (25, 2), NaN where the body lacks them."""
    known = np.isfinite(body).all(1)
    roi = body_region(np.column_stack([np.nan_to_num(body), known]))
    return np.zeros(4, np.float32) if roi is None else np.array(dataclasses.astuple(roi), np.float32)
