"""Normal maps of the posed body model itself."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from soar.geometry.meshes import vertex_normals
from soar.raster import Pinhole, RasterSettings, rasterise_mesh
from soar.raster.types import Backend


def body_maps(vertices: Tensor, faces: Tensor, pinhole: Pinhole, backend: Backend) -> tuple[np.ndarray, np.ndarray]:
    """Front and back normals of a closed mesh, each (H, W, 3) float32, unit or zero.

    Args:
        vertices: (V, 3) metres, camera space.
        faces: (F, 3), counter-clockwise seen from outside.
        pinhole: the view.
        backend: of the z-buffer.
    """
    normals = vertex_normals(vertices, faces)
    maps = []
    for side in ("front", "back"):
        seen = rasterise_mesh(vertices, faces, pinhole, side, backend)
        hit = seen.face >= 0
        corners = normals[faces[seen.face[hit].long()]]  # (P, 3, 3)
        out = normals.new_zeros(*hit.shape, 3)
        out[hit] = torch.nn.functional.normalize((corners * seen.barycentrics[hit][..., None]).sum(1), dim=-1)
        maps.append(out.numpy())
    return maps[0], maps[1]


@dataclasses.dataclass(frozen=True)
class BodyNormalSettings:
    """Node ``normals`` with the provider ``body``.

    Attributes:
        provider: ``body``.
    """

    provider: Literal["body"]


class BodyNormals:
    """The posed body model's own normals: smooth, without clothes or hair, and there for every pose and view."""

    def __init__(self, options: BodyNormalSettings, raster: RasterSettings, threads: int) -> None:
        self.backend = raster.backend

    def maps(
        self, rgb: np.ndarray, alpha: np.ndarray, vertices: Tensor, faces: Tensor, pinhole: Pinhole
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; the photograph and its mask are not looked at."""
        return body_maps(vertices, faces, pinhole, self.backend)
