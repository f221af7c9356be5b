"""Rotated square regions of interest: cropping an image into a network's tensor, and mapping its answers back.

Points are continuous image coordinates. A region's corners map exactly onto the corners of the tensor, without the
half-pixel shift of usual resampling and without area averaging: this is how the networks were trained, and either
change moves their landmarks by up to a crop pixel.
"""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np


def wrap_angle(angle: float) -> float:
    """The equivalent angle in [-pi, pi), radians."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


@dataclasses.dataclass(frozen=True)
class Roi:
    """A square of the image.

    Attributes:
        cx, cy: centre, pixels.
        side: edge length, pixels.
        rotation: radians, positive clockwise in the image.
    """

    cx: float
    cy: float
    side: float
    rotation: float

    @property
    def usable(self) -> bool:
        """Whether the region is finite and at least two pixels wide."""
        return all(map(math.isfinite, dataclasses.astuple(self))) and self.side >= 2

    def axes(self) -> np.ndarray:
        """(2, 2) rotation whose columns are the region's x and y directions in the image."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        return np.array([[c, -s], [s, c]])

    def image_from_crop(self, size: int, mirrored: bool = False) -> np.ndarray:
        """(2, 3) affine map from pixels of the ``size`` x ``size`` tensor to image pixels."""
        linear = self.axes() @ np.diag([-1.0 if mirrored else 1.0, 1.0]) * (self.side / size)
        centre = np.array([self.cx, self.cy])
        return np.column_stack([linear, centre - linear @ np.full(2, size / 2)])

    def crop(self, image: np.ndarray, size: int, *, border: int, mirrored: bool = False) -> np.ndarray:
        """Sample the region bilinearly.

        Args:
            image: (H, W, 3) uint8.
            size: edge length of the result, pixels.
            border: ``cv2.BORDER_REPLICATE`` or ``cv2.BORDER_CONSTANT`` (zero) outside the image.
            mirrored: flip the result left to right.

        Returns:
            (size, size, 3) uint8.
        """
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(image, self.image_from_crop(size, mirrored), (size, size), flags=flags, borderMode=border)

    def to_image(self, points: np.ndarray, size: float, mirrored: bool = False) -> np.ndarray:
        """Map points (..., 2) of the ``size``-wide tensor to image pixels."""
        M = self.image_from_crop(size, mirrored)
        return points @ M[:, :2].T + M[:, 2]

    def to_crop(self, points: np.ndarray, size: float, mirrored: bool = False) -> np.ndarray:
        """Map image points (..., 2) to pixels of the ``size``-wide tensor."""
        M = self.image_from_crop(size, mirrored)
        return (points - M[:, 2]) @ np.linalg.inv(M[:, :2]).T

    def changed(self, scale: float, rotation: float) -> Roi:
        """The region ``scale`` times as wide, turned by ``rotation`` radians about its centre."""
        return dataclasses.replace(self, side=self.side * scale, rotation=wrap_angle(self.rotation + rotation))

    def straightened(self, lean: float) -> Roi:
        """The region turned back to ``lean`` times its rotation if that is under a quarter turn."""
        if abs(self.rotation) > math.pi / 2:
            return self
        return dataclasses.replace(self, rotation=self.rotation * lean)

    def overlap(self, other: Roi) -> float:
        """Intersection over union of the two squares, rotations ignored."""
        width, height = (
            max(0.0, (self.side + other.side) / 2 - abs(a - b)) for a, b in ((self.cx, other.cx), (self.cy, other.cy))
        )
        small = min(self.side, other.side)
        shared = min(width, small) * min(height, small)
        return shared / (self.side**2 + other.side**2 - shared)

    def contains(self, x: float, y: float) -> bool:
        """Whether an image point lies in the region."""
        u, v = self.to_crop(np.array([x, y]), 1.0)
        return bool(0 <= u <= 1 and 0 <= v <= 1)


def letterbox(width: int, height: int) -> Roi:
    """The upright square around a whole image."""
    return Roi(width / 2, height / 2, float(max(width, height)), 0.0)


def _rotation(p0: np.ndarray, p1: np.ndarray, target: float) -> float:
    return wrap_angle(target - math.atan2(-(p1[1] - p0[1]), p1[0] - p0[0]))


def _placed(centre: np.ndarray, side: float, rotation: float, shift: float, scale: float) -> Roi:
    x = centre[0] - shift * math.sin(rotation)
    y = centre[1] + shift * math.cos(rotation)
    return Roi(float(x), float(y), float(side * scale), rotation)


def align(p0: np.ndarray, p1: np.ndarray, *, target: float, scale: float, shift_y: float = 0.0) -> Roi:
    """The region centred at ``p0`` in which the direction from ``p0`` to ``p1`` points at ``target``.

    Args:
        p0, p1: (2,) image points; twice their distance is the unscaled side.
        target: radians, counter-clockwise from the region's x axis (pi/2 is up).
        scale: factor on the side.
        shift_y: shift of the centre along the region's y axis, in unscaled sides.
    """
    side = 2 * float(np.hypot(*(p1 - p0)))
    return _placed(p0, side, _rotation(p0, p1, target), shift_y * side, scale)


def around(points: np.ndarray, p0: np.ndarray, p1: np.ndarray, *, target: float, scale: float, shift_y: float) -> Roi:
    """The region around the upright bounding box of ``points`` (N, 2), turned as in :func:`align`.

    ``shift_y`` is in heights of the bounding box.
    """
    low, high = points.min(0), points.max(0)
    width, height = high - low
    rotation = _rotation(p0, p1, target)
    return _placed((low + high) / 2, max(width, height), rotation, shift_y * height, scale)
