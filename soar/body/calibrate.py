"""Refinement of camera rotations on the person's own joints.

Calibrations shipped with recordings are often off by half a degree to a degree per camera, which shifts every joint
of a camera by the same 5 to 15 pixels. With three or more cameras the joints themselves reveal it: bundle adjustment
over one rotation per camera and free joint positions, with a robust loss and a weak prior on the rotations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from soar.body.observations import Observations
from soar.body.openpose import LIMBS
from soar.body.triangulate import TriangulationSettings, geman_mcclure_weight, reproject, residuals, triangulate
from soar.errors import CalibrationError, NumericalError
from soar.geometry.cameras import Camera
from soar.geometry.rotations import axis_angle_to_matrix

MIN_CAMERAS = 3


@dataclasses.dataclass(frozen=True)
class CalibrateSettings:
    """Settings of :func:`refine_rotations` (node ``calibrate``).

    Attributes:
        enabled: refine; False passes the calibration through.
        min_confidence: keypoints below count as not seen.
        sigma: Geman-McClure scale of residuals, percent of the person's box height.
        prior_deg: standard deviation of the rotation errors expected, degrees.
        iterations: reweighted Gauss-Newton steps.
        min_points: limb joints that a camera must share with another, over all frames.
        triangulation: how points are triangulated for the start and for the residuals reported.
    """

    enabled: bool
    min_confidence: float
    sigma: float
    prior_deg: float
    iterations: int
    min_points: int
    triangulation: TriangulationSettings


@dataclasses.dataclass(frozen=True)
class Refinement:
    """Cameras before and after, and what each leaves of the limb joints' reprojection residual.

    Attributes:
        cameras, original: refined and given cameras; equal where nothing was applied.
        applied: whether rotations were refined.
        remark: a sentence for the user.
        linear, before, after: median residual in pixels of linear triangulation with the given cameras, of robust
            triangulation with the given and with the refined cameras.
        residual_before, residual_after: (C, T, 12, 2) pixels, NaN where not seen.
        angles_deg: (C,) rotation applied to each camera.
    """

    cameras: tuple[Camera, ...]
    original: tuple[Camera, ...]
    applied: bool
    remark: str
    linear: float
    before: float
    after: float
    residual_before: np.ndarray
    residual_after: np.ndarray
    angles_deg: np.ndarray

    def per_camera(self, which: np.ndarray) -> dict[str, float]:
        """Median residual in pixels by camera name of ``residual_before`` or ``residual_after``."""
        return {c.name: _median(r) for c, r in zip(self.cameras, which, strict=True)}


def refine_rotations(seen: Observations, settings: CalibrateSettings) -> Refinement:
    """Refine the rotation of each camera about its own centre.

    Raises:
        CalibrationError: a camera shares too few joints with any other, or too few of them lie in front of it.
        NumericalError: the adjustment diverged.
    """
    cameras = seen.cameras
    points, confidence = seen.points[:, :, list(LIMBS)], seen.confidence[:, :, list(LIMBS)]
    unit = (seen.box_height() / 100)[..., None]
    linear_only = dataclasses.replace(settings.triangulation, iterations=0)

    def left(cams: Sequence[Camera], how: TriangulationSettings) -> np.ndarray:
        X = triangulate(cams, points, confidence, unit, how)
        return np.where(confidence[..., None] > 0, residuals(cams, X, points), np.nan)

    if len(cameras) == 1:
        nothing = np.full((1, *confidence.shape[1:], 2), np.nan)
        remark = "One camera: nothing to triangulate, its calibration is used as given."
        return Refinement(cameras, cameras, False, remark, *([float("nan")] * 3), nothing, nothing, np.zeros(1))
    check_common(cameras, confidence, settings.min_points)
    linear, before = left(cameras, linear_only), left(cameras, settings.triangulation)
    if not settings.enabled or len(cameras) < MIN_CAMERAS:
        remark = (
            "Camera refinement is switched off." if not settings.enabled
            else f"Fewer than {MIN_CAMERAS} cameras: their rotations are used as given."
        )  # fmt: skip
        value = _median(before)
        return Refinement(
            cameras, cameras, False, remark, _median(linear), value, value, before, before, np.zeros(len(cameras))
        )
    refined = _adjust(cameras, points, confidence, unit, settings)
    after = left(refined, settings.triangulation)
    angles = np.degrees([angle_between(a.R, b.R) for a, b in zip(cameras, refined, strict=True)])
    remark = (
        f"Rotations refined by {angles.min():.2f} to {angles.max():.2f} degrees on the limb joints of all cameras "
        "(of evaluation cameras too, but never on their colours)."
    )
    return Refinement(
        refined, cameras, True, remark, _median(linear), _median(before), _median(after), before, after, angles
    )


def check_common(cameras: Sequence[Camera], confidence: np.ndarray, min_points: int) -> None:
    """Require that every camera sees ``min_points`` joints that another camera sees too.

    Args:
        confidence: (C, T, N); 0 = not seen.

    Raises:
        CalibrationError: naming the camera and the number of points it shares.
    """
    seen = confidence > 0
    for c, camera in enumerate(cameras):
        shared = int((seen[c] & (seen.sum(0) >= 2)).sum())
        if shared < min_points:
            raise CalibrationError(
                f"camera {camera.name} sees too little of what the other cameras see",
                expected=f"{min_points} limb joints in common over the clip",
                got=str(shared),
                cure="leave the camera out, check the synchronisation, or lower calibrate.min_points",
            )


def _adjust(
    cameras: Sequence[Camera], points: np.ndarray, confidence: np.ndarray, unit: np.ndarray, settings: CalibrateSettings
) -> tuple[Camera, ...]:
    """Cameras whose rotations, with free joint positions, minimise the robust residual.

    Reweighted Gauss-Newton; the joints are eliminated by the Schur complement, so a step solves a 3C x 3C system.
    """
    X = triangulate(cameras, points, confidence, unit, settings.triangulation)
    usable = np.isfinite(X).all(-1)
    X, points, confidence = X[usable], points[:, usable], confidence[:, usable]
    unit = np.broadcast_to(unit, (len(cameras), *usable.shape))[:, usable]
    turned, total = tuple(cameras), np.zeros((len(cameras), 3))
    stiffness = np.eye(3 * len(cameras)) / np.radians(settings.prior_deg) ** 2
    for _ in range(settings.iterations):
        residual, by_point = reproject(turned, X, points)
        # A turn w of the camera moves a camera-space point q by w x q = -q x w.
        by_turn = np.stack([
            d @ c.R.T @ -_hat(c.to_camera(X)) for c, d in zip(turned, by_point, strict=True)
        ])  # fmt: skip
        w = confidence * geman_mcclure_weight((residual**2).sum(-1), settings.sigma * unit) / unit**2
        Hxx = np.einsum("cn,cnai,cnaj->nij", w, by_point, by_point) + 1e-9 * np.eye(3)
        Hwx = np.einsum("cn,cnai,cnaj->ncij", w, by_turn, by_point)
        Hww = np.einsum("cn,cnai,cnaj->cij", w, by_turn, by_turn)
        gx = np.einsum("cn,cnai,cna->ni", w, by_point, residual)
        gw = np.einsum("cn,cnai,cna->ci", w, by_turn, residual)
        inverse = np.linalg.inv(Hxx)
        H = stiffness - np.einsum("ncik,nkl,ndjl->cidj", Hwx, inverse, Hwx).reshape(stiffness.shape)
        for c in range(len(cameras)):
            H[3 * c : 3 * c + 3, 3 * c : 3 * c + 3] += Hww[c]
        g = gw - np.einsum("ncik,nkl,nl->ci", Hwx, inverse, gx) + (total.reshape(-1) @ stiffness).reshape(-1, 3)
        step = -np.linalg.solve(H, g.reshape(-1)).reshape(-1, 3)
        X = X - np.einsum("nij,nj->ni", inverse, gx + np.einsum("ncji,cj->ni", Hwx, step))
        turned = tuple(camera.turned(turn) for camera, turn in zip(turned, rotations(step), strict=True))
        total = total + step
        if not (np.isfinite(X).all() and np.isfinite(step).all()):
            raise NumericalError(
                "the camera refinement diverged", cure="check the calibration, or calibrate.enabled=false"
            )
    return turned


def rotations(turns: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of axis-angle vectors (..., 3) in radians."""
    return axis_angle_to_matrix(torch.from_numpy(turns)).numpy()


def _hat(v: np.ndarray) -> np.ndarray:
    """Cross-product matrices (..., 3, 3) of (..., 3)."""
    return np.cross(v[..., None, :], -np.eye(3))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians of the rotation between two rotations (3, 3)."""
    return float(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / np.sqrt(8))))


def _median(residual: np.ndarray) -> float:
    length = np.linalg.norm(residual, axis=-1)
    return float(np.nanmedian(length)) if np.isfinite(length).any() else float("nan")
