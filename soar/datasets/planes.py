"""Pictures that hold what a dataset knows of its frames, and what is cut out of them."""

from __future__ import annotations

import numpy as np

from soar.datasets.crops import cut
from soar.datasets.ingest import resample

DEPTH_STEP = 0.25e-3
"""Metres that a step of a depth picture stands for: 16 bits reach 16.4 m."""


def picture_of(plane: str, values: np.ndarray) -> np.ndarray:
    """What stands in the archive for a plane of :meth:`soar.datasets.truth.Truth.planes`.

    Alpha is (H, W) uint8. Normals are (H, W, 3) uint8 ``128 + round(127 n)``, black where there is none. Depth is
    (H, W) uint16 in units of :data:`DEPTH_STEP`, 0 where there is none.
    """
    if plane == "alpha":
        return np.round(255 * values).astype(np.uint8)
    if plane == "depth":
        return np.round(values / DEPTH_STEP).clip(0, 65535).astype(np.uint16)
    there = np.abs(values).max(-1, keepdims=True) > 0
    return np.where(there, 128 + np.round(127 * values), 0).astype(np.uint8)


def normals_of(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 normals that a picture (H, W, 3) uint8 stands for, zero where it is black."""
    there = picture.max(-1, keepdims=True) > 0
    return np.where(there, (picture.astype(np.float32) - 128) / 127, np.float32(0))


def cropped_normals(picture: np.ndarray, scale: float, rect: np.ndarray) -> np.ndarray:
    """Normals of a whole frame, cut as the frame was.

    Args:
        picture: (H, W, 3) uint8, see :func:`picture_of`.
        scale: of the working resolution to the frame.
        rect: (4,) x0, y0, width, height of the window at working resolution.

    Returns:
        (height, width, 3) float32 unit normals, zero where at least half of a pixel holds none.
    """
    height, width = (round(scale * side) for side in picture.shape[:2])
    normals = cut(resample(normals_of(picture), width, height), rect)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0.5, normals / length.clip(1e-6), np.float32(0))
