"""Triangle meshes as arrays: normals, edges, midpoint subdivision."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def face_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unnormalised face normals (..., F, 3), twice the area long, of vertices (..., V, 3) and faces (F, 3)."""
    a, b, c = (vertices[..., faces[:, i], :] for i in range(3))
    return torch.linalg.cross(b - a, c - a)


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Area-weighted unit vertex normals (..., V, 3); zero where a vertex has no face."""
    n = face_normals(vertices, faces)
    out = torch.zeros_like(vertices)
    for i in range(3):
        out.index_add_(-2, faces[:, i], n)
    return torch.nn.functional.normalize(out, dim=-1)


def edges(faces: np.ndarray) -> np.ndarray:
    """Unique undirected edges (E, 2), sorted, of faces (F, 3)."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0)


def subdivide(faces: np.ndarray, *attributes: np.ndarray) -> tuple[np.ndarray, ...]:
    """Midpoint subdivision: each triangle becomes four, each edge gains a vertex.

    Args:
        faces: (F, 3) int.
        *attributes: per-vertex arrays (V, ...), averaged at midpoints.

    Returns:
        faces (4F, 3) and each attribute as (V + E, ...).
    """
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    count = len(attributes[0]) if attributes else int(faces.max()) + 1
    ab, bc, ca = (count + inverse.reshape(-1, 3)).T
    a, b, c = faces.T
    children = np.stack([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))], 1)
    middle = tuple(np.concatenate([x, 0.5 * (x[unique[:, 0]] + x[unique[:, 1]])]).astype(x.dtype) for x in attributes)
    return (children.reshape(-1, 3), *middle)


def compact(faces: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Keep some faces and drop the vertices no longer used.

    Args:
        faces: (F, 3) int.
        keep: (F,) bool.

    Returns:
        faces of the smaller mesh (F', 3) and the indices (V',) of the vertices it keeps.
    """
    used, inverse = np.unique(faces[keep], return_inverse=True)
    return inverse.reshape(-1, 3), used
