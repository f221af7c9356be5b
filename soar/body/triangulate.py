"""Points in space from several calibrated views, robust against views that are wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from soar.geometry.cameras import Camera


@dataclasses.dataclass(frozen=True)
class TriangulationSettings:
    """Settings of :func:`triangulate`.

    Attributes:
        sigma: Geman-McClure scale of the reprojection residual, percent of the person's box height.
        iterations: reweighted Gauss-Newton steps after the linear solution; 0 = linear only.
    """

    sigma: float
    iterations: int


def triangulate(
    cameras: Sequence[Camera],
    points: np.ndarray,
    confidence: np.ndarray,
    unit: np.ndarray,
    settings: TriangulationSettings,
) -> np.ndarray:
    """Minimise the robust, confidence-weighted reprojection residual of each point.

    Args:
        cameras: C cameras.
        points: (C, ..., 2) pixels.
        confidence: (C, ...) weights; 0 = not seen.
        unit: (C, ...) pixels per percent-of-box-height unit, broadcastable against ``confidence``.
        settings: robustness.

    Returns:
        (..., 3) metres; NaN where fewer than two cameras see the point.
    """
    shape = confidence.shape[1:]
    pixels = points.reshape(len(cameras), -1, 2)
    weight = confidence.reshape(len(cameras), -1)
    scale = np.broadcast_to(unit, confidence.shape).reshape(weight.shape)
    P = np.stack([c.K @ c.T_cam_from_world[:3] for c in cameras])
    rows = pixels[..., None] * P[:, None, 2:] - P[:, None, :2]
    # Rows in pixels at unit depth are of the order of the focal length: normalise before weighting.
    rows = (rows / np.stack([c.K[0, 0] for c in cameras])[:, None, None, None]) * weight[..., None, None]
    A = np.moveaxis(rows, 0, 1).reshape(weight.shape[1], -1, 4)
    enough = (weight > 0).sum(0) >= 2
    X = np.full((weight.shape[1], 3), np.nan)
    if not enough.any():
        return X.reshape(*shape, 3)
    homogeneous = np.linalg.svd(A[enough])[2][:, -1]
    x = homogeneous[:, :3] / homogeneous[:, 3:]
    w, p, s = weight[:, enough], pixels[:, enough], scale[:, enough]
    for _ in range(settings.iterations):
        residual, jacobian = reproject(cameras, x, p)
        robust = w * geman_mcclure_weight((residual**2).sum(-1), settings.sigma * s) / s**2
        H = np.einsum("cn,cnai,cnaj->nij", robust, jacobian, jacobian) + 1e-9 * np.eye(3)
        g = np.einsum("cn,cnai,cna->ni", robust, jacobian, residual)
        x = x - np.linalg.solve(H, g[..., None])[..., 0]
    X[enough] = x
    return X.reshape(*shape, 3)


def geman_mcclure_weight(square: np.ndarray, sigma: np.ndarray | float) -> np.ndarray:
    """Weight of a squared residual in reweighted least squares for ``rho = s^2 r^2 / (s^2 + r^2)``."""
    return (sigma**2 / (sigma**2 + square)) ** 2


def residuals(cameras: Sequence[Camera], X: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Projected minus observed, pixels (C, ..., 2), of space points (..., 3)."""
    return np.stack([camera.project(X) for camera in cameras]) - points


def reproject(cameras: Sequence[Camera], x: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual (C, N, 2) and its Jacobian (C, N, 2, 3) with respect to x (N, 3)."""
    jacobians = []
    for camera in cameras:
        q = camera.to_camera(x)
        f = camera.K[0, 0], camera.K[1, 1]
        z = np.where(np.abs(q[:, 2]) < 1e-6, 1e-6, q[:, 2])
        d = np.zeros((len(x), 2, 3))
        d[:, 0, 0], d[:, 1, 1] = f[0] / z, f[1] / z
        d[:, 0, 2], d[:, 1, 2] = -f[0] * q[:, 0] / z**2, -f[1] * q[:, 1] / z**2
        jacobians.append(d @ camera.R)
    return residuals(cameras, x, pixels), np.stack(jacobians)
