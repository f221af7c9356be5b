"""Cameras that walk round a standing body."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.geometry.cameras import look_at


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A circle of cameras that all see the whole of a set of points.

    Attributes:
        centre: (3,) what the cameras look at, metres.
        up: (3,) unit axis of the circle.
        front: (3,) unit vector, across ``up``, from the centre to the camera of angle 0.
        distance: radius of the circle, metres.
        focal: focal length in pixels; the principal point is the image centre.
        width, height: image size in pixels.
    """

    centre: np.ndarray
    up: np.ndarray
    front: np.ndarray
    distance: float
    focal: float
    width: int
    height: int

    @staticmethod
    def around(points: np.ndarray, up: np.ndarray, front: np.ndarray, height: int, fov: float, margin: float) -> Orbit:
        """Fit a circle of cameras to points.

        The points' upright bounding cylinder, whose axis passes through the middle of their bounding box, fills the
        image but for the margin, so that the body never touches the border at any angle.

        Args:
            points: (N, 3) metres.
            up: (3,) direction of the axis.
            front: (3,) direction, not along ``up``, that faces the camera of angle 0.
            height: image height in pixels; the width (even) follows from the cylinder.
            fov: vertical field of view, radians.
            margin: free share of the image on each side, below one half.
        """
        up = up / np.linalg.norm(up)
        front = front - (front @ up) * up
        front = front / np.linalg.norm(front)
        axes = np.stack([np.cross(up, front), up, front])
        local = points @ axes.T
        middle = (local.min(0) + local.max(0)) / 2
        offset = local - middle
        radius, half = float(np.hypot(offset[:, 0], offset[:, 2]).max()), float(np.abs(offset[:, 1]).max())
        room = 1.0 - 2.0 * margin
        tangent = np.tan(fov / 2)
        # The cylinder's rim comes nearest to the camera at distance - radius, where it appears largest.
        distance = radius + half / (room * tangent)
        focal = 0.5 * height / tangent
        side = focal * radius / np.sqrt(distance**2 - radius**2)
        width = 2 * int(np.ceil(side / room))
        return Orbit(middle @ axes, up, front, distance, focal, width, height)

    @property
    def K(self) -> np.ndarray:
        """(3, 3) intrinsics, pixels."""
        return np.array([[self.focal, 0, self.width / 2], [0, self.focal, self.height / 2], [0, 0, 1]])

    def T_cam_from_world(self, angle: float) -> np.ndarray:
        """(4, 4) pose of the camera ``angle`` radians on from the front, counter-clockwise seen from above."""
        side = np.cross(self.up, self.front)
        outward = np.cos(angle) * self.front + np.sin(angle) * side
        return look_at(self.centre, -outward, self.up, self.distance)
