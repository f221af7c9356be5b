"""Scenes the benchmarks and some tests share: a standing figure of surfels, as uneven in density as a body model's."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from soar.raster import Pinhole

SURFELS = 167_333
"""Surfels of the paper's avatars: a body model of 10,475 vertices, subdivided twice."""

# Capsules (end, end, radius in metres) and their share of the surfels; y points down, the feet stand at y = 0.85.
# Head and hands are as dense as in body models: a tenth of the surface and half of the points.
_CAPSULES = [
    ((0.00, -0.72, 0.00), (0.00, -0.66, 0.01), 0.105, 0.30),
    ((-0.08, -0.42, 0.00), (0.08, -0.42, 0.00), 0.14, 0.08),
    ((-0.05, -0.10, 0.00), (0.05, -0.10, 0.00), 0.15, 0.08),
    ((-0.20, -0.45, 0.00), (-0.42, -0.25, 0.03), 0.05, 0.04),
    ((0.20, -0.45, 0.00), (0.42, -0.25, 0.03), 0.05, 0.04),
    ((-0.42, -0.25, 0.03), (-0.58, -0.05, -0.05), 0.04, 0.04),
    ((0.42, -0.25, 0.03), (0.58, -0.05, -0.05), 0.04, 0.04),
    ((-0.60, -0.03, -0.06), (-0.66, 0.06, -0.08), 0.035, 0.11),
    ((0.60, -0.03, -0.06), (0.66, 0.06, -0.08), 0.035, 0.11),
    ((-0.09, 0.00, 0.00), (-0.14, 0.42, 0.02), 0.075, 0.04),
    ((0.09, 0.00, 0.00), (0.14, 0.42, 0.02), 0.075, 0.04),
    ((-0.14, 0.42, 0.02), (-0.16, 0.80, 0.00), 0.05, 0.04),
    ((0.14, 0.42, 0.02), (0.16, 0.80, 0.00), 0.05, 0.04),
]


def figure(count: int = SURFELS, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Positions, normals, scales, colours, occlusion of ``count`` surfels, camera space, 3 metres away.

    Scales are mean distances to the three nearest neighbours, as avatars start with.
    """
    rng = np.random.default_rng(seed)
    counts = np.floor(np.array([c[3] for c in _CAPSULES]) / sum(c[3] for c in _CAPSULES) * count).astype(int)
    counts[0] += count - counts.sum()
    parts = [_capsule(np.array(a), np.array(b), r, n, rng) for (a, b, r, _), n in zip(_CAPSULES, counts, strict=True)]
    points, normals = (np.concatenate(x) for x in zip(*parts, strict=True))
    # A capsule's points inside another are left in: hidden surfels exist in bodies too.
    distance, _ = cKDTree(points).query(points, k=4)
    points = points + np.array([0.0, 0.0, 3.0])
    arrays = points, normals, distance[:, 1:].mean(1), 0.5 + 0.5 * normals, rng.random(len(points))
    return tuple(torch.from_numpy(x).float() for x in arrays)  # type: ignore[return-value]


def view(size: int) -> Pinhole:
    """A square view that the figure fills."""
    focal = 0.879 * size * 3 / 1.626
    return Pinhole(focal, focal, size / 2, size / 2, size, size)


def _capsule(
    a: np.ndarray, b: np.ndarray, radius: float, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    axis = b - a
    length = np.linalg.norm(axis)
    axis /= length
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    # Height along the axis of a capsule's surface is uniform: a sphere's area per height is a cylinder's.
    height = rng.uniform(-radius, length + radius, count)
    beyond = height - np.clip(height, 0, length)
    angle = rng.uniform(0, 2 * np.pi, count)
    around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
    normals = (beyond / radius)[:, None] * axis + np.sqrt(np.clip(1 - (beyond / radius) ** 2, 0, 1))[:, None] * around
    return a + np.clip(height, 0, length)[:, None] * axis + radius * normals, normals
