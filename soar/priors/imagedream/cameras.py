"""How ImageDream is told a camera."""

from __future__ import annotations

import torch
from torch import Tensor


def embedding(azimuth: Tensor, elevation: Tensor) -> Tensor:
    """(V, 16): camera-to-world, row by row, of cameras at distance 1 that look at the origin.

    World: z up; the person stands facing +x, their left towards +y, so that the image prompt, the front, is azimuth 0.
    Camera axes are those of OpenGL: x right, y up, looking along -z.

    Args:
        azimuth: (V,) degrees from the front towards the person's left.
        elevation: (V,) degrees above the horizon, less than 90.
    """
    azimuth, elevation = torch.deg2rad(azimuth), torch.deg2rad(elevation)
    sin_a, cos_a, sin_e, cos_e = azimuth.sin(), azimuth.cos(), elevation.sin(), elevation.cos()
    zero = torch.zeros_like(azimuth)
    right = torch.stack([-sin_a, cos_a, zero], -1)
    up = torch.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], -1)
    back = torch.stack([cos_e * cos_a, cos_e * sin_a, sin_e], -1)  # and the camera's place, at distance 1
    upper = torch.stack([right, up, back, back], -1)
    last = upper.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(upper), 1, 4)
    return torch.cat([upper, last], 1).flatten(1)
