"""Pinhole cameras in the OpenCV convention: x right, y down, z forward, pixel centres at +0.5."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from soar.errors import CalibrationError


@dataclasses.dataclass(frozen=True)
class Camera:
    """One calibrated camera.

    Attributes:
        name: identifier, unique within a sequence.
        width, height: image size in pixels.
        K: (3, 3) intrinsics in pixels.
        T_cam_from_world: (4, 4) rigid transform, metres.
        distortion: (5,) OpenCV k1 k2 p1 p2 k3; zero for the undistorted frames that stages exchange.
        K_source: where the intrinsics come from, in words ("calibration", "assumed field of view of 60 degrees").
    """

    name: str
    width: int
    height: int
    K: np.ndarray
    T_cam_from_world: np.ndarray
    distortion: np.ndarray
    K_source: str

    def __post_init__(self) -> None:
        for field, shape in (("K", (3, 3)), ("T_cam_from_world", (4, 4)), ("distortion", (5,))):
            value = np.asarray(getattr(self, field), np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise CalibrationError(
                    f"camera {self.name}: {field} is malformed", expected=f"finite {shape}", got=str(value)
                )
            object.__setattr__(self, field, value)
        R = self.R
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
            raise CalibrationError(
                f"camera {self.name}: the upper 3x3 of T_cam_from_world is not a rotation",
                expected="orthonormal rows, determinant +1",
                got=f"determinant {np.linalg.det(R):.4f}",
                cure="check handedness and that the transform maps world to camera",
            )
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0 or self.width < 1 or self.height < 1:
            raise CalibrationError(f"camera {self.name}: focal length and size must be positive")

    @property
    def R(self) -> np.ndarray:
        """(3, 3) rotation, camera from world."""
        return self.T_cam_from_world[:3, :3]

    @property
    def t(self) -> np.ndarray:
        """(3,) translation, camera from world, metres."""
        return self.T_cam_from_world[:3, 3]

    @property
    def centre(self) -> np.ndarray:
        """(3,) position in the world, metres."""
        return -self.R.T @ self.t

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) in metres to camera space (..., 3)."""
        return points @ self.R.T + self.t

    def project(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) to pixels (..., 2); the distortion is not applied."""
        p = self.to_camera(points) @ self.K.T
        return p[..., :2] / p[..., 2:]

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same image resampled to ``width`` x ``height`` pixels."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return dataclasses.replace(self, width=width, height=height, K=scale @ self.K)

    def cropped(self, x0: int, y0: int, width: int, height: int) -> Camera:
        """The camera of the window whose top-left pixel is (x0, y0); the window may leave the image."""
        K = self.K.copy()
        K[0, 2] -= x0
        K[1, 2] -= y0
        return dataclasses.replace(self, width=width, height=height, K=K)

    def turned(self, rotation: np.ndarray) -> Camera:
        """The camera turned about its own centre by ``rotation`` (3, 3), turned camera from this one."""
        T = np.eye(4)
        T[:3, :3] = rotation
        return dataclasses.replace(self, T_cam_from_world=T @ self.T_cam_from_world)

    def to_json(self) -> dict[str, Any]:
        """A plain mapping that :meth:`from_json` reads back."""
        return {
            "name": self.name,
            "width": self.width,
            "height": self.height,
            "K": self.K.tolist(),
            "T_cam_from_world": self.T_cam_from_world.tolist(),
            "distortion": self.distortion.tolist(),
            "K_source": self.K_source,
        }

    @staticmethod
    def from_json(value: Mapping[str, Any]) -> Camera:
        """Read a camera; raises :class:`~soar.errors.CalibrationError` for a missing or malformed entry."""
        try:
            return Camera(**{f.name: value[f.name] for f in dataclasses.fields(Camera)})
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(f"a camera entry lacks or malforms {error}", got=str(value)[:200]) from error


def look_at(centre: np.ndarray, forward: np.ndarray, up: np.ndarray, distance: float) -> np.ndarray:
    """(4, 4) ``T_cam_from_world`` of an upright camera.

    Args:
        centre: (3,) what it looks at, metres.
        forward: (3,) unit vector along its axis, not along ``up``.
        up: (3,) unit vector.
        distance: metres from the camera to the centre.
    """
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    T[:3, 3] = -T[:3, :3] @ (centre - distance * forward)
    return T
