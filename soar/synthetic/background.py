"""What stands behind a person: sRGB planes (3, H, W) float32, and the composition of a picture."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from soar.synthetic.render import Maps

GREY = 0.5


def plain(height: int, width: int, colour: tuple[float, float, float] = (GREY,) * 3) -> Tensor:
    """One sRGB colour."""
    return torch.tensor(colour, dtype=torch.float32)[:, None, None].expand(3, height, width).clone()


def procedural(height: int, width: int, rng: np.random.Generator) -> Tensor:
    """Wall and floor: two shaded colours that meet at a horizon, broken by smooth blotches and a few straight edges."""
    y, x = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    wall, floor = torch.from_numpy(rng.uniform(0.15, 0.9, (2, 3, 1, 1))).float()
    horizon, slope = rng.uniform(0.55, 0.9), rng.normal(0, 0.05)
    picture = torch.where(y > horizon + slope * (x - 0.5), floor, wall)
    for _ in range(rng.integers(0, 5)):  # furniture, doors, windows: boxes of another colour
        box = torch.from_numpy(rng.uniform(0, 0.9, 2)).float()
        size = torch.from_numpy(rng.uniform(0.08, 0.5, 2)).float()
        inside = (x > box[0]) & (x < box[0] + size[0]) & (y > box[1] - 0.2) & (y < box[1] + size[1])
        colour = torch.from_numpy(rng.uniform(0.1, 0.95, (3, 1, 1))).float()
        picture = torch.where(inside, picture + rng.uniform(0.3, 1.0) * (colour - picture), picture)
    for cells, strength in ((3, 0.12), (9, 0.06), (40, 0.03)):
        grid = torch.from_numpy(rng.normal(0, strength, (1, 3, cells, cells))).float()
        picture = (
            picture + torch.nn.functional.interpolate(grid, (height, width), mode="bilinear", align_corners=True)[0]
        )
    picture = picture * (1 + rng.normal(0, 0.25) * (x - 0.5) + rng.normal(0, 0.25) * (y - 0.5))
    return picture.clamp(0, 1).float()


def composed(maps: Maps, background: Tensor) -> Tensor:
    """(3, H, W) sRGB: the clothed person before ``background`` (3, H, W)."""
    return maps.colour * maps.alpha + background * (1 - maps.alpha)
