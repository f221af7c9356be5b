"""An avatar on its strings: pose it by a frame of a motion and look at it through a camera."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from soar.avatar.articulate import Articulation, pose
from soar.avatar.surfels import Avatar
from soar.raster import Pinhole, RasterSettings, Rendered, rasterise


class Puppet:
    """An avatar with its skinning weights, ready to be rendered without gradients.

    Args:
        avatar: the surfels.
        articulation: the body's motion.
        raster: filter and backend of the rasteriser.
    """

    def __init__(self, avatar: Avatar, articulation: Articulation, raster: RasterSettings) -> None:
        self.avatar, self.articulation, self.raster = avatar, articulation, raster
        self.normals = avatar.normals
        self.blend = articulation.blend(avatar.positions, avatar.neighbours)

    def pose(self, frame: int, T_cam_from_world: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (N, 3), metres, and unit normals (N, 3) in the space of camera ``T_cam_from_world`` (4, 4)."""
        transforms = self.articulation.in_camera(frame, T_cam_from_world)
        return pose(self.avatar.positions, self.normals, self.blend, transforms)

    @torch.no_grad()
    def render(
        self,
        frame: int,
        T_cam_from_world: Tensor,
        pinhole: Pinhole,
        *,
        side: Literal["front", "back"] = "front",
        colours: Tensor | None = None,
    ) -> Rendered:
        """Render one frame of the motion; ``colours`` (N, 3) replace the avatar's own (to show tau, or parts)."""
        positions, normals = self.pose(frame, T_cam_from_world)
        a = self.avatar
        shown = a.colours if colours is None else colours
        return rasterise(positions, normals, a.scales, shown, a.occlusion, pinhole, side=side, settings=self.raster)
