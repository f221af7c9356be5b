"""Surfels to images: the public entry, and the native kernel as an autograd function."""

from __future__ import annotations

import weakref
from typing import Any

import torch
from torch import Tensor

from soar.errors import InputError
from soar.raster import reference
from soar.raster.library import choose, library
from soar.raster.types import CHANNELS, Pinhole, RasterSettings, Rendered, Side


def rasterise(
    positions: Tensor,
    normals: Tensor,
    scales: Tensor,
    colours: Tensor,
    occlusion: Tensor,
    pinhole: Pinhole,
    *,
    side: Side,
    settings: RasterSettings,
) -> Rendered:
    """Render surfels into one view, differentiably.

    Args:
        positions: (N, 3) metres, camera space (x right, y down, z forward).
        normals: (N, 3) unit, camera space, outward.
        scales: (N,) standard deviation of the disk, metres, > 0.
        colours: (N, 3).
        occlusion: (N,) in [0, 1]; its image's gradient reaches this argument alone.
        pinhole: the view.
        side: ``front`` composes the nearest surfel first, ``back`` the farthest; with culling the first drops surfels
            that face away from the camera and the second those that face it.
        settings: filter, culling and backend.

    Returns:
        planes of the inputs' dtype; surfels behind the camera or outside the view contribute nothing.

    Raises:
        InputError: shapes do not fit each other.
        ConfigError: the backend cannot be had.
    """
    (rendered,) = _passes((positions, normals, scales, colours, occlusion), pinhole, settings, side)
    return rendered


def rasterise_both(
    positions: Tensor,
    normals: Tensor,
    scales: Tensor,
    colours: Tensor,
    occlusion: Tensor,
    pinhole: Pinhole,
    *,
    settings: RasterSettings,
) -> tuple[Rendered, Rendered]:
    """Front and back pass of one view (see :func:`rasterise`), projecting the surfels once where the backend can."""
    front, back = _passes((positions, normals, scales, colours, occlusion), pinhole, settings, "front", "back")
    return front, back


def _passes(
    surfels: tuple[Tensor, Tensor, Tensor, Tensor, Tensor], pinhole: Pinhole, settings: RasterSettings, *sides: Side
) -> list[Rendered]:
    """One render per side, in the order of ``sides``."""
    _check(*surfels)
    if choose(settings.backend, *surfels) == "native":
        front, back = _Splat.apply(*surfels, pinhole, settings, sides)
        return [Rendered(front if side == "front" else back) for side in sides]
    filter = (settings.lowpass_px2, settings.compensate, settings.cull)
    return [reference.rasterise(*surfels, pinhole, side, *filter) for side in sides]


def _check(positions: Tensor, normals: Tensor, scales: Tensor, colours: Tensor, occlusion: Tensor) -> None:
    shapes = [tuple(t.shape) for t in (positions, normals, scales, colours, occlusion)]
    n = len(positions)
    expected = [(n, 3), (n, 3), (n,), (n, 3), (n,)]
    if shapes != expected:
        raise InputError("surfels do not fit each other", expected=str(expected), got=str(shapes))


def _pointer(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()


class _Splat(torch.autograd.Function):
    """The native kernel. A pass that is not asked for is None, in and out."""

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor | None, Tensor | None]:
        *surfels, pinhole, settings, sides = arguments
        surfels = [t.detach().contiguous() for t in surfels]
        shape = (CHANNELS, pinhole.height, pinhole.width)
        front, back = (surfels[0].new_empty(shape) if side in sides else None for side in ("front", "back"))
        intrinsics = torch.tensor([pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy], dtype=torch.float32)
        native = library()
        handle = native.soar_surfels_forward(
            *map(_pointer, surfels), len(surfels[0]), intrinsics.data_ptr(), pinhole.width, pinhole.height,
            settings.lowpass_px2, settings.compensate, settings.cull, _pointer(front), _pointer(back),
            torch.get_num_threads(),
        )  # fmt: skip
        if not handle:
            size = f"{pinhole.width} x {pinhole.height}"
            raise MemoryError(f"rendering {len(surfels[0])} surfels at {size} ran out of memory")
        ctx.context = _Context(native, handle)
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*surfels, front, back)
        return front, back

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, g_front: Tensor | None, g_back: Tensor | None) -> tuple[Tensor | None, ...]:
        *surfels, front, back = ctx.saved_tensors
        g_front, g_back = (None if g is None else g.contiguous() for g in (g_front, g_back))
        gradients = [torch.empty_like(t) for t in surfels]
        done = ctx.context.native.soar_surfels_backward(
            ctx.context.handle, *map(_pointer, surfels), len(surfels[0]), _pointer(front), _pointer(back),
            _pointer(g_front), _pointer(g_back), *map(_pointer, gradients), torch.get_num_threads(),
        )  # fmt: skip
        if not done:
            raise MemoryError(f"the gradient of {len(surfels[0])} surfels ran out of memory")
        return *gradients, None, None, None


class _Context:
    """The forward pass's lists; given back to the library's pool when autograd lets go of them."""

    def __init__(self, native: Any, handle: int) -> None:
        self.native, self.handle = native, handle
        weakref.finalize(self, native.soar_surfels_release, handle)
