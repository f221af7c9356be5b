"""Differentiable surfel rasteriser, mesh z-buffer and hash grid: a torch reference and a native twin of each.

All take camera-space or unit-cube coordinates and know nothing of bodies, files or configuration groups.
"""

from soar.raster.hashgrid import hash_encode
from soar.raster.library import has_native
from soar.raster.mesh import rasterise_mesh
from soar.raster.surfels import rasterise, rasterise_both
from soar.raster.types import MeshFragments, Pinhole, RasterSettings, Rendered

__all__ = [
    "MeshFragments",
    "Pinhole",
    "RasterSettings",
    "Rendered",
    "has_native",
    "hash_encode",
    "rasterise",
    "rasterise_both",
    "rasterise_mesh",
]
