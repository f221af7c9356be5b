"""Terms that keep the surface a surface where no pixel speaks (the paper's L_reg and our substitutes)."""

from __future__ import annotations

import torch
from torch import Tensor

from soar.losses.normal import dot, normalise
from soar.raster import Pinhole


def depth_normals(depth: Tensor, visible: Tensor, pinhole: Pinhole) -> Tensor:
    """Normals (3, H, W), camera space and unit, of the surface a depth map shows; n_z < 0, zero where not visible.

    The four triangles a pixel forms with its neighbours vote with their areas (Gaussian surfels, Dai et al. 2024).

    Args:
        depth: (H, W) metres along z.
        visible: (H, W) bool; neighbours that are not visible have no vote.
        pinhole: the camera.
    """
    height, width = depth.shape
    rows = (torch.arange(height, dtype=depth.dtype, device=depth.device) + 0.5 - pinhole.cy) / pinhole.fy
    columns = (torch.arange(width, dtype=depth.dtype, device=depth.device) + 0.5 - pinhole.cx) / pinhole.fx
    points = torch.stack([depth * columns, depth * rows[:, None], depth])
    right = (points[:, :, 1:] - points[:, :, :-1]) * (visible[:, 1:] & visible[:, :-1])
    down = (points[:, 1:] - points[:, :-1]) * (visible[1:] & visible[:-1])
    # The four cross products share their factors: (r - l) x (d - u) has the same sum.
    across = torch.nn.functional.pad(right, (0, 1)) + torch.nn.functional.pad(right, (1, 0))
    along = torch.nn.functional.pad(down, (0, 0, 0, 1)) + torch.nn.functional.pad(down, (0, 0, 1, 0))
    (ax, ay, az), (bx, by, bz) = across.unbind(0), along.unbind(0)
    crossed = torch.stack([az * by - ay * bz, ax * bz - az * bx, ay * bx - ax * by])
    return normalise(crossed) * visible


def normal_depth(normals: Tensor, depth: Tensor, alpha: Tensor, pinhole: Pinhole) -> Tensor:
    """Mean of 1 - cos between rendered normals and those of the rendered depth, over the covered pixels.

    Args:
        normals: (3, H, W) accumulated.
        depth: (H, W) accumulated; divided by alpha here.
        alpha: (H, W).
        pinhole: the camera.
    """
    visible = alpha > 0.5
    surface = depth_normals(depth / alpha.clamp_min(1e-3), visible, pinhole)
    known = visible & (dot(surface, surface) > 0.5)
    return ((1 - dot(normalise(normals), surface)) * known).sum() / known.sum().clamp_min(1)


def curvature(normals: Tensor, alpha: Tensor) -> Tensor:
    """Mean over covered pixels of |sum of the four neighbour differences of the normal map|_1 (Gaussian surfels).

    Args:
        normals: (3, H, W) accumulated.
        alpha: (H, W).
    """
    visible = alpha > 0.5
    n = normalise(normals)
    right = (n[:, :, 1:] - n[:, :, :-1]) * (visible[:, 1:] & visible[:, :-1])
    down = (n[:, 1:] - n[:, :-1]) * (visible[1:] & visible[:-1])
    pad = torch.nn.functional.pad
    bend = pad(right, (0, 1)) - pad(right, (1, 0)) + pad(down, (0, 0, 0, 1)) - pad(down, (0, 0, 1, 0))
    return (bend.abs().sum(0) * visible).sum() / visible.sum().clamp_min(1)


def offset(positions: Tensor, rest: Tensor) -> Tensor:
    """Mean distance in metres of surfels (N, 3) from where the body put them (N, 3)."""
    return ((positions - rest).square().sum(-1) + 1e-12).sqrt().mean()


def offset_laplacian(positions: Tensor, rest: Tensor, neighbours: Tensor) -> Tensor:
    """Mean square, in square metres, of a surfel's offset against the mean offset of its neighbours.

    What the image does not hold moves along with what it does, so the border of the seen side does not tear.

    Args:
        positions, rest: (N, 3) metres.
        neighbours: (N, k) indices of neighbours on the body surface.
    """
    d = positions - rest
    mean = d.index_select(0, neighbours.flatten()).unflatten(0, neighbours.shape).mean(1)
    return (d - mean).square().sum(-1).mean()


def scale_mean(scales: Tensor) -> Tensor:
    """Mean radius in metres (the paper's scale term). It opens holes on the side that no pixel holds closed."""
    return scales.mean()


def scale_log(scales: Tensor, start: Tensor) -> Tensor:
    """Mean square of log(s / s_start) of radii (N,): neither shrinks nor grows what is not observed."""
    return (scales / start).log().square().mean()
