"""Mesh z-buffer: which face each pixel centre sees first (front) or last (back)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from soar.errors import InputError
from soar.raster.library import choose, library
from soar.raster.reference import NEAR
from soar.raster.types import Backend, MeshFragments, Pinhole, Side


def rasterise_mesh(
    vertices: Tensor | np.ndarray, faces: Tensor | np.ndarray, pinhole: Pinhole, side: Side, backend: Backend = "auto"
) -> MeshFragments:
    """Nearest (``front``) or farthest (``back``) face at each pixel centre; not differentiable.

    Both orientations of a face are drawn. A face with a corner behind the camera is left out. Of faces at equal depth
    the first in the list is taken.

    Args:
        vertices: (V, 3) metres, camera space.
        faces: (F, 3) indices.
        pinhole: the view.
        side: which surface.
        backend: ``native``, ``reference`` or ``auto``.

    Raises:
        InputError: shapes or indices do not fit.
        ConfigError: the backend cannot be had.
    """
    vertices = torch.as_tensor(vertices).detach().to("cpu", torch.float32).contiguous()
    faces = torch.as_tensor(faces).to("cpu", torch.int64).contiguous()
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        got = f"{tuple(vertices.shape)}, {tuple(faces.shape)}"
        raise InputError("a mesh is malformed", expected="(V, 3), (F, 3)", got=got)
    if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise InputError("a face names a vertex that is not there", expected=f"0..{len(vertices) - 1}")
    if choose(backend, vertices) == "reference":
        return _reference(vertices.double(), faces, pinhole, side)
    shape = (pinhole.height, pinhole.width)
    face, depth = torch.empty(shape, dtype=torch.int32), torch.empty(shape)
    barycentrics = torch.empty(*shape, 3)
    intrinsics = torch.tensor([pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy], dtype=torch.float32)
    done = library().soar_mesh(
        vertices.data_ptr(), len(vertices), faces.data_ptr(), len(faces), intrinsics.data_ptr(), pinhole.width,
        pinhole.height, side == "back", face.data_ptr(), barycentrics.data_ptr(), depth.data_ptr(),
        torch.get_num_threads(),
    )  # fmt: skip
    if not done:
        raise MemoryError(f"rasterising {len(faces)} faces at {pinhole.width} x {pinhole.height} ran out of memory")
    return MeshFragments(face, barycentrics, depth)


def _reference(vertices: Tensor, faces: Tensor, pinhole: Pinhole, side: Side) -> MeshFragments:
    """Every (face, pixel of its box) pair is tested; per pixel the winner of a stable sort by depth is kept."""
    height, width = pinhole.height, pinhole.width
    corners = vertices[faces]  # (F, 3, 3)
    ahead = (corners[..., 2] > NEAR).all(1)
    z = torch.where(ahead[:, None], corners[..., 2], 1.0)
    xy = torch.stack([pinhole.fx * corners[..., 0] / z + pinhole.cx, pinhole.fy * corners[..., 1] / z + pinhole.cy], -1)
    low, high = (xy.amin(1) - 0.5).ceil().clamp_min(0), (xy.amax(1) - 0.5).floor()
    high = torch.minimum(high, high.new_tensor([width - 1, height - 1]))
    seen = (ahead & (low <= high).all(1)).nonzero()[:, 0]
    wide, tall = (high - low + 1)[seen].long().unbind(1)
    item = torch.repeat_interleave(seen, wide * tall)
    across = torch.repeat_interleave(wide, wide * tall)
    within = torch.arange(len(item)) - torch.repeat_interleave((wide * tall).cumsum(0) - wide * tall, wide * tall)
    row = torch.div(within, across, rounding_mode="floor")
    pixel = torch.stack([within - row * across, row], 1) + low[item].long()

    edges = xy[item].roll(-1, 1), xy[item].roll(-2, 1)  # the edge opposite each corner
    along, to = edges[1] - edges[0], pixel[:, None] + 0.5 - edges[0]
    opposite = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    first, second = xy[item, 1] - xy[item, 0], xy[item, 2] - xy[item, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    weights = opposite / area[:, None]
    inside = (area != 0) & (weights >= 0).all(1)
    item, pixel, weights = item[inside], pixel[inside], weights[inside] / z[item[inside]]
    nearness = weights.sum(1)
    weights = weights / nearness[:, None]

    flat = pixel[:, 1] * width + pixel[:, 0]
    by_depth = torch.argsort(-nearness if side == "front" else nearness, stable=True)
    order = by_depth[torch.argsort(flat[by_depth], stable=True)]
    best = torch.ones_like(order, dtype=torch.bool)
    best[1:] = flat[order][1:] != flat[order][:-1]
    order = order[best]
    face = torch.full((height * width,), -1, dtype=torch.int32)
    barycentrics, depth = torch.zeros(height * width, 3), torch.full((height * width,), torch.inf)
    face[flat[order]] = item[order].int()
    barycentrics[flat[order]] = weights[order].float()
    depth[flat[order]] = (1 / nearness[order]).float()
    return MeshFragments(face.view(height, width), barycentrics.view(height, width, 3), depth.view(height, width))
