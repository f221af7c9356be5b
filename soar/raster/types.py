"""What goes into and comes out of the rasterisers."""

from __future__ import annotations

import dataclasses
import functools
from typing import Literal

import numpy as np
from torch import Tensor

from soar.errors import ConfigError, InputError

Side = Literal["front", "back"]
Backend = Literal["auto", "reference", "native"]

CHANNELS = 9
"""Planes of a render: colour 3, normal 3, depth, alpha, occlusion."""

MAX_SIDE = 1 << 15
"""Largest width or height of a render in pixels; the kernels keep pixel rows and columns in 16 bits."""


@dataclasses.dataclass(frozen=True)
class Pinhole:
    """Intrinsics of an undistorted view, OpenCV axes, pixel centres at +0.5.

    Attributes:
        fx, fy, cx, cy: focal lengths and principal point in pixels.
        width, height: size of the image in pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_SIDE and 0 < self.height <= MAX_SIDE and self.fx > 0 and self.fy > 0):
            raise InputError(
                "a view cannot be rendered",
                expected=f"positive focal lengths, width and height in 1..{MAX_SIDE}",
                got=str(self),
            )

    @staticmethod
    def from_K(K: np.ndarray | Tensor, width: int, height: int) -> Pinhole:
        """Intrinsics (3, 3) in pixels; a skew entry is ignored."""
        return Pinhole(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), int(width), int(height))


@dataclasses.dataclass(frozen=True)
class RasterSettings:
    """How surfels are splatted (node ``raster``).

    Attributes:
        lowpass_px2: variance in square pixels added to both axes of a surfel's footprint, > 0.
        compensate: lower the opacity so that the filter keeps the surfel's integral.
        cull: front passes drop surfels that face away, back passes those that face the camera.
        backend: ``native``, ``reference``, or ``auto`` = native where the library is there.
    """

    lowpass_px2: float
    compensate: bool
    cull: bool
    backend: Backend

    def __post_init__(self) -> None:
        if not self.lowpass_px2 > 0:
            got = str(self.lowpass_px2)
            raise ConfigError("raster.lowpass_px2 must be positive", got=got, cure="1/12 is a pixel's own")


@dataclasses.dataclass(frozen=True)
class Rendered:
    """One pass over the surfels of a view.

    Attributes:
        planes: (9, H, W): colour 3, normal 3, depth, alpha, occlusion; nothing is composed behind them.
    """

    planes: Tensor

    @functools.cached_property
    def _parts(self) -> tuple[Tensor, ...]:
        # One split, not five slices: its backward is one concatenation instead of five zero-filled images.
        return self.planes.split((3, 3, 1, 1, 1))

    @property
    def colour(self) -> Tensor:
        """(3, H, W) sum of weight x colour; compose a background as ``colour + (1 - alpha) * background``."""
        return self._parts[0]

    @property
    def normal(self) -> Tensor:
        """(3, H, W) sum of weight x camera-space normal, not renormalised, never flipped."""
        return self._parts[1]

    @property
    def depth(self) -> Tensor:
        """(H, W) sum of weight x depth in metres; divide by alpha for the expected depth."""
        return self._parts[2][0]

    @property
    def alpha(self) -> Tensor:
        """(H, W) coverage in [0, 1]."""
        return self._parts[3][0]

    @property
    def occlusion(self) -> Tensor:
        """(H, W) sum of weight x occlusion; its gradient reaches the surfels' occlusion and nothing else."""
        return self._parts[4][0]


@dataclasses.dataclass(frozen=True)
class MeshFragments:
    """What each pixel centre sees of a mesh.

    Attributes:
        face: (H, W) int32 index of the face, -1 where there is none.
        barycentrics: (H, W, 3) float32 perspective-correct weights of the face's corners, zero where there is none.
        depth: (H, W) float32 depth z in metres, infinite where there is none.
    """

    face: Tensor
    barycentrics: Tensor
    depth: Tensor
