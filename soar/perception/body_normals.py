"""Normal maps of the posed body model itself."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from soar.geometry.meshes import vertex_normals
from soar.perception.normal_maps import Context, Crop
from soar.raster import Pinhole, rasterise_mesh
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

    remarks = ()

    def __init__(self, options: BodyNormalSettings, context: Context) -> None:
        self.backend = context.backend

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; the photograph and its mask are not looked at."""
        return body_maps(crop.vertices, crop.faces, crop.pinhole, self.backend)


FRONT_ONLY = "The normal maps are of the front only; behind, the body model's own normals stand in."
"""Remark of a provider that uses :func:`behind`."""


def behind(crop: Crop, inside: np.ndarray, backend: Backend) -> np.ndarray:
    """The body's back normals (H, W, 3) float32 within a mask (H, W), for a provider that knows the front only."""
    return np.where(inside[..., None], body_maps(crop.vertices, crop.faces, crop.pinhole, backend)[1], np.float32(0))
