"""The rasteriser's specification: torch, any floating type and device, differentiable by autograd.

A surfel is a round disk at mu = (x, y, z) with unit normal n and standard deviation s, in camera space. Because it is
round, its covariance s^2 (I - n n^T) does not depend on the rotation within the disk. Its affine image has

    (a, b) = (x, y) / z,  m = (fx a + cx, fy b + cy),  k1 = s fx / z,  k2 = s fy / z,
    u1 = n0 - a n2,  u2 = n1 - b n2,  cosine = n . (a, b, 1),
    S11 = k1^2 (1 + a^2 - u1^2),  S12 = k1 k2 (a b - u1 u2),  S22 = k2^2 (1 + b^2 - u2^2),
    sqrt(det S) = k1 k2 |cosine|,

to which the low-pass variance h of a pixel is added on the diagonal. With ``compensate`` the opacity is
sqrt(det S / det(S + h)), so that the blurred disk keeps the integral of the sharp one. The depth plane through the
disk is z + zx dx + zy dy with zx = -z n0 / (fx c), zy = -z n1 / (fy c), where c is the cosine, kept from zero.

Surfels are composed front to back in order of z (back passes: the farthest first); ties go by index. A contribution
alpha = min(0.99, opacity exp(-1/2 d^T (S + h)^-1 d)) below 1/255 is dropped; a pixel takes nothing more once its
transmittance is 1e-4 or less. The gradient of the occlusion channel reaches the occlusion values only (SOAR: tau is
found with everything else held), so one pass serves all channels.
"""

from __future__ import annotations

import torch
from torch import Tensor

from soar.raster.types import CHANNELS, Pinhole, Rendered, Side

NEAR = 0.01
"""Metres; a surfel or vertex at or before this depth is not drawn."""
MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE = 1 / 255, 0.99, 1e-4
MIN_SLOPE_COSINE = 0.1
"""Below it the depth slope stops growing: grazing disks would otherwise throw depth by metres."""


def rasterise(
    positions: Tensor,
    normals: Tensor,
    scales: Tensor,
    colours: Tensor,
    occlusion: Tensor,
    pinhole: Pinhole,
    side: Side,
    lowpass_px2: float,
    compensate: bool,
    cull: bool,
) -> Rendered:
    """Render one pass; see :func:`soar.raster.rasterise` for the arguments and the module for the mathematics."""
    x, y, z = positions.unbind(-1)
    n0, n1, n2 = normals.unbind(-1)
    ahead = z > NEAR
    z = torch.where(ahead, z, torch.ones_like(z))
    a, b = x / z, y / z
    k1, k2 = scales * pinhole.fx / z, scales * pinhole.fy / z
    u1, u2 = n0 - a * n2, n1 - b * n2
    cosine = n0 * a + n1 * b + n2
    h = lowpass_px2
    s11 = k1 * k1 * (1 + a * a - u1 * u1)
    s12 = k1 * k2 * (a * b - u1 * u2)
    s22 = k2 * k2 * (1 + b * b - u2 * u2)
    area = k1 * k2 * cosine.abs()
    det = area * area + h * (s11 + s22) + h * h  # sums of positive terms: s11 s22 - s12^2 cancels for edge-on disks
    opacity = area / det.sqrt() if compensate else torch.ones_like(area)
    slope = torch.where(cosine < 0, -1.0, 1.0) * cosine.abs().clamp_min(MIN_SLOPE_COSINE)
    zx, zy = -z * n0 / (pinhole.fx * slope), -z * n1 / (pinhole.fy * slope)
    mx, my = pinhole.fx * a + pinhole.cx, pinhole.fy * b + pinhole.cy

    def contribution(surfel: Tensor, column: Tensor, row: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        dx, dy = column + 0.5 - mx[surfel], row + 0.5 - my[surfel]
        q = (s22[surfel] + h) * dx * dx - 2 * s12[surfel] * dx * dy + (s11[surfel] + h) * dy * dy
        return opacity[surfel] * torch.exp(-0.5 * q / det[surfel]), dx, dy

    with torch.no_grad():
        seen = ahead & (opacity >= MIN_ALPHA) & (det > 0)
        if cull:
            seen &= (cosine < 0) if side == "front" else (cosine > 0)
        reach = 2 * torch.log(opacity.clamp_min(MIN_ALPHA) / MIN_ALPHA)
        extent_x = (reach * (s11 + h)).sqrt() + 1e-3
        extent_y = (reach * (s22 + h)).sqrt() + 1e-3
        x0, x1 = (mx - extent_x - 0.5).ceil().clamp_min(0), (mx + extent_x - 0.5).floor().clamp_max(pinhole.width - 1)
        y0, y1 = (my - extent_y - 0.5).ceil().clamp_min(0), (my + extent_y - 0.5).floor().clamp_max(pinhole.height - 1)
        seen &= (x0 <= x1) & (y0 <= y1) & torch.isfinite(extent_x + extent_y)
        order = torch.argsort(z if side == "front" else -z, stable=True)
        order = order[seen[order]]
        surfel, column, row = _pairs(x0.long(), x1.long(), y0.long(), y1.long(), order)

        near = contribution(surfel, column, row)[0] >= MIN_ALPHA
        surfel, column, row = surfel[near], column[near], row[near]
        pixel = row * pinhole.width + column
        by_pixel = torch.argsort(pixel, stable=True)  # within a pixel the order of depth stays
        surfel, column, row, pixel = surfel[by_pixel], column[by_pixel], row[by_pixel], pixel[by_pixel]

    alpha, dx, dy = contribution(surfel, column, row)
    alpha = alpha.clamp_max(MAX_ALPHA)
    transmittance = _transmittance(alpha, pixel)
    weight = torch.where(transmittance > MIN_TRANSMITTANCE, transmittance * alpha, torch.zeros_like(alpha))
    depth = z[surfel] + zx[surfel] * dx + zy[surfel] * dy
    channels = torch.cat(
        [
            weight[:, None] * colours[surfel],
            weight[:, None] * normals[surfel],
            (weight * depth)[:, None],
            weight[:, None],
            (weight.detach() * occlusion[surfel])[:, None],
        ],
        1,
    )
    flat = channels.new_zeros(pinhole.height * pinhole.width, CHANNELS).index_add(0, pixel, channels)
    return Rendered(flat.T.reshape(CHANNELS, pinhole.height, pinhole.width))


def _pairs(x0: Tensor, x1: Tensor, y0: Tensor, y1: Tensor, order: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Every (item, column, row) with the pixel inside the item's inclusive box; items in the given order."""
    wide = (x1 - x0 + 1)[order]
    count = wide * (y1 - y0 + 1)[order]
    item = torch.repeat_interleave(order, count)
    within = torch.arange(len(item), device=order.device) - torch.repeat_interleave(count.cumsum(0) - count, count)
    row = torch.div(within, torch.repeat_interleave(wide, count), rounding_mode="floor")
    column = within - row * torch.repeat_interleave(wide, count)
    return item, column + x0[item], row + y0[item]


def _transmittance(alpha: Tensor, pixel: Tensor) -> Tensor:
    """Product of (1 - alpha) over the earlier entries of the same pixel; entries are grouped by pixel."""
    # One running sum over all pixels, in float64: in float32 its rounding would exceed single contributions.
    log = torch.log1p(-alpha.double())
    before = log.cumsum(0) - log
    new = torch.ones_like(pixel, dtype=torch.bool)
    new[1:] = pixel[1:] != pixel[:-1]
    start = torch.cummax(torch.where(new, torch.arange(len(pixel), device=pixel.device), 0), 0).values
    return (before - before[start]).exp().to(alpha.dtype)
