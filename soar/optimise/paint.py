"""The baseline that optimises nothing: every surfel takes the mean colour of the pixels that see it."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar, nearest
from soar.errors import SubjectError
from soar.optimise.views import Views
from soar.progress import track
from soar.raster import RasterSettings


@dataclasses.dataclass(frozen=True)
class PaintSettings:
    """When a pixel speaks for a surfel (``conf/paint``)."""

    min_cosine: float
    depth_tolerance: float
    min_mask: float
    donor_mask: float


def paint(
    start: Avatar, articulation: Articulation, views: list[Views], settings: PaintSettings, raster: RasterSettings
) -> tuple[Avatar, Tensor]:
    """Colour the surfels from all training crops.

    A surfel's colour is the mean, weighted by the squared cosine between its normal and the ray, of the pixels at its
    projections where it faces the camera, nothing is in front of it, and the mask holds. A surfel that no pixel sees
    takes the colour of the nearest one that was seen well inside the mask: colours at its border hold some background.

    Returns:
        the avatar, tau 0 where seen and 1 elsewhere, and which surfels were seen (N,) bool.

    Raises:
        SubjectError: no surfel is seen by any pixel: body and images do not belong together.
    """
    puppet = Puppet(start, articulation, raster)
    colour = torch.zeros_like(start.positions)
    weight = torch.zeros_like(start.scales)
    donor = torch.zeros_like(start.scales, dtype=torch.bool)
    pairs = [(view, index) for view in views for index in range(len(view))]
    for view, index in track(pairs, "paint"):
        frame = int(view.frames[index])
        positions, normals = puppet.pose(frame, view.T_cam_from_world)
        pinhole = view.pinhole(index)
        rendered = puppet.render(frame, view.T_cam_from_world, pinhole)
        facing = -(positions * normals).sum(-1) / positions.norm(dim=-1)
        depth = positions[:, 2].clamp_min(1e-6)
        pixel = torch.stack([pinhole.fx * positions[:, 0], pinhole.fy * positions[:, 1]], -1) / depth[:, None]
        pixel = pixel + pixel.new_tensor([pinhole.cx, pinhole.cy])
        surface = rendered.depth / rendered.alpha.clamp_min(1e-3)
        planes = torch.cat([view.image(index).to(positions), view.mask(index).to(positions)[None], surface[None]])
        red, green, blue, mask, seen_depth = sample(planes, pixel)
        good = (facing > settings.min_cosine) & (mask > settings.min_mask) & (positions[:, 2] > 0)
        good &= (positions[:, 2] - seen_depth).abs() < settings.depth_tolerance
        w = facing.square() * good
        colour += w[:, None] * torch.stack([red, green, blue], -1)
        weight += w
        donor |= good & (mask > settings.donor_mask)
    seen = weight > 0
    if not bool(donor.any()):
        raise SubjectError(
            "no surfel of the body is seen in any training frame",
            expected="the projected body inside the masks",
            got="no pixel that faces, is unoccluded and well inside the mask",
            cure="look at the evidence pictures of the body and masks stages",
        )
    colours = colour / weight.clamp_min(1e-12)[:, None]
    _, source = nearest(start.rest_positions[donor], start.rest_positions, 1)
    colours = torch.where(seen[:, None], colours, colours[donor][source[:, 0]])
    return start.replace(colours=colours.clamp(0, 1), occlusion=(~seen).to(start.scales)), seen


def sample(planes: Tensor, pixels: Tensor) -> Tensor:
    """Bilinear samples (C, N) of planes (C, H, W) at pixel positions (N, 2) x, y, centres at +0.5; zero outside."""
    height, width = planes.shape[1:]
    grid = 2 * pixels / pixels.new_tensor([width, height]) - 1
    return grid_sample(planes[None], grid[None, None], align_corners=False, padding_mode="zeros")[0, :, 0]
