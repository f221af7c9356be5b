"""What surfels cover, from first principles: rays through many points of every pixel, cut with every disk."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from torch import Tensor

from soar.raster import Pinhole

MIN_ALPHA, MAX_ALPHA = 1 / 255, 0.99
_REACH = np.sqrt(-2 * np.log(MIN_ALPHA))  # standard deviations at which a disk's alpha is dropped
_PAIRS = 1 << 21  # (disk, ray) pairs in memory at a time


def coverage(positions: Tensor, normals: Tensor, scales: Tensor, pinhole: Pinhole, samples: int) -> np.ndarray:
    """(H, W) alpha of the surfels that face the camera, averaged over ``samples`` x ``samples`` rays per pixel.

    A ray meets a disk's plane at a distance of rho standard deviations from its centre and is stopped there by
    min(0.99, exp(-rho^2 / 2)), by nothing below 1/255. What is left of it is a product, in any order. No footprint is
    linearised and nothing is filtered, so none of the rasteriser's own steps is taken for granted.

    Args:
        positions, normals, scales: (N, 3), (N, 3), (N,) as for :func:`soar.raster.rasterise`; no camera inside a disk.
        pinhole: the view.
        samples: rays per pixel side.
    """
    mu, n, s = (t.double().numpy() for t in (positions, normals, scales))
    facing = (mu * n).sum(1) < 0  # the camera is on the outer side of the disk's plane
    mu, n, s = mu[facing], n[facing], s[facing]
    # In units of a disk's size: the plane's distance from the camera, and the centre.
    plane, centre = (mu * n).sum(1) / s, mu / s[:, None]
    width, height = samples * pinhole.width, samples * pinhole.height
    x0, x1 = _extent(mu[:, 0], mu[:, 2], _REACH * s, pinhole.fx * samples, pinhole.cx * samples, width)
    y0, y1 = _extent(mu[:, 1], mu[:, 2], _REACH * s, pinhole.fy * samples, pinhole.cy * samples, height)
    log_open = np.zeros(width * height)
    for disk, column, row in _pairs(x0, x1, y0, y1):
        a = ((column + 0.5) / samples - pinhole.cx) / pinhole.fx
        b = ((row + 0.5) / samples - pinhole.cy) / pinhole.fy
        normal, middle = n[disk], centre[disk]
        along = plane[disk] / (normal[:, 0] * a + normal[:, 1] * b + normal[:, 2])
        rho2 = (along * a - middle[:, 0]) ** 2 + (along * b - middle[:, 1]) ** 2 + (along - middle[:, 2]) ** 2
        alpha = np.exp(-0.5 * rho2)
        hit = (alpha >= MIN_ALPHA) & (along > 0)
        log = np.log1p(-np.minimum(alpha[hit], MAX_ALPHA))
        log_open += np.bincount((row * width + column)[hit], log, minlength=width * height)
    open_share = np.exp(log_open).reshape(pinhole.height, samples, pinhole.width, samples)
    return 1 - open_share.mean(axis=(1, 3))


def _extent(
    x: np.ndarray, z: np.ndarray, radius: np.ndarray, focal: float, middle: float, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """First and last sample of a row that a ball about (x, z) can touch; rays through it span an angle."""
    angle, half = np.arctan2(x, z), np.arcsin(radius / np.hypot(x, z))
    low, high = (focal * np.tan(angle + sign * half) + middle for sign in (-1, 1))
    return np.maximum(np.ceil(low - 0.5), 0).astype(int), np.minimum(np.floor(high - 0.5), size - 1).astype(int)


def _pairs(
    x0: np.ndarray, x1: np.ndarray, y0: np.ndarray, y1: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Every (disk, column, row) of the disks' boxes of samples, some disks at a time."""
    wide = np.maximum(x1 - x0 + 1, 0)
    count = wide * np.maximum(y1 - y0 + 1, 0)
    parts = np.cumsum(count) // _PAIRS
    for disks in np.split(np.arange(len(count)), np.flatnonzero(np.diff(parts)) + 1):
        disk = np.repeat(disks, count[disks])
        within = np.arange(len(disk)) - np.repeat(np.cumsum(count[disks]) - count[disks], count[disks])
        row, column = np.divmod(within, wide[disk])
        yield disk, x0[disk] + column, y0[disk] + row
