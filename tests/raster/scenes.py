"""Scenes of the rasteriser's tests."""

from __future__ import annotations

import torch
from torch import Tensor

from soar.config import settings
from soar.raster import Pinhole, RasterSettings
from tests.conftest import conf

VIEW = Pinhole(160.0, 158.0, 47.3, 41.2, 96, 80)


def raster(**changes: object) -> RasterSettings:
    """The default settings with some fields changed."""
    return settings(RasterSettings, conf("raster", "default") | changes)


def cloud(count: int, dtype: torch.dtype = torch.float64, seed: int = 1) -> list[Tensor]:
    """Surfels scattered in a box that fills :data:`VIEW`, with random normals; float32-representable values."""
    g = torch.Generator().manual_seed(seed)
    positions = torch.rand(count, 3, generator=g) * torch.tensor([1.6, 1.4, 0.6]) + torch.tensor([-0.8, -0.7, 2.7])
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=-1)
    scales = torch.rand(count, generator=g) * 0.02 + 0.003
    colours, occlusion = torch.rand(count, 3, generator=g), torch.rand(count, generator=g)
    return [t.to(dtype) for t in (positions, normals, scales, colours, occlusion)]


def sphere(subdivisions: int = 4) -> tuple[Tensor, Tensor]:
    """Vertices (V, 3) and faces (F, 3) of a sphere of radius 0.5 about (0, 0, 3), outward winding."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    return torch.tensor(mesh.vertices).float() + torch.tensor([0.0, 0.0, 3.0]), torch.tensor(mesh.faces)
