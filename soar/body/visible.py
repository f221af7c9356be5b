"""Which faces of a closed body nobody outside can see, such as the backs of its eyeballs."""

from __future__ import annotations

import numpy as np
import torch

from soar.geometry.cameras import look_at
from soar.raster import Pinhole, rasterise_mesh

_VIEWS = 96  # directions, spread evenly over the sphere
_PIXEL = 0.0015  # metres; the triangles of a face are hardly smaller
_FAR = 20.0  # distance of the cameras in radii of the body, so that they look all but parallel


def hidden(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool, True for faces that are behind others from every side.

    Each direction's z-buffer tells which faces are seen. A face between seen ones may have missed every pixel's centre,
    so it is hidden only if at most one of its neighbours is seen.

    Args:
        vertices: (V, 3) metres, in a pose that covers as little as can be.
        faces: (F, 3).
    """
    centre = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    size = int(np.ceil(2 * radius / _PIXEL))
    pinhole = Pinhole(_FAR * size / 2, _FAR * size / 2, size / 2, size / 2, size, size)
    points = torch.from_numpy(vertices)
    seen = np.zeros(len(faces), bool)
    for forward in sphere(_VIEWS):
        T = torch.from_numpy(look_at(centre, forward, np.roll(forward, 1), _FAR * radius))
        found = rasterise_mesh(points.double() @ T[:3, :3].T + T[:3, 3], faces, pinhole, "front").face.numpy()
        seen[np.unique(found[found >= 0])] = True
    return ~(seen | (_seen_neighbours(faces, seen) >= 2))


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly spread: the spherical Fibonacci lattice."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1)


def _seen_neighbours(faces: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(F,) number of seen faces across the three edges of each face."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, edge = np.unique(pairs, axis=0, return_inverse=True)
    edge = edge.reshape(-1, 3)
    at_edge = np.bincount(edge.ravel(), np.repeat(seen, 3))
    return (at_edge[edge] - seen[:, None] > 0).sum(1)
