"""A painted toy avatar, filmed: what the optimisation tests are given, with the truth known."""

from __future__ import annotations

import math

import numpy as np
import torch

from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar, from_body
from soar.optimise.views import Views
from soar.raster import Pinhole
from tests.avatar import toy

PINHOLE = Pinhole(fx=170.0, fy=170.0, cx=48.0, cy=64.0, width=96, height=128)


def articulation(frames: int = 4) -> Articulation:
    """The toy body's motion."""
    return Articulation.of(toy.body(), toy.motion(frames))


def start() -> Avatar:
    """Grey and on the body."""
    return from_body(toy.body(), toy.motion().betas, toy.avatar_settings(subdivisions=1))


def truth() -> Avatar:
    """Fatter than the body by 1 cm, red below, green above, blue on the back."""
    avatar = start()
    red, green, blue = torch.tensor([0.9, 0.2, 0.1]), torch.tensor([0.1, 0.7, 0.2]), torch.tensor([0.1, 0.2, 0.9])
    colours = torch.where(avatar.rest_positions[:, 2:] < 0.5, red, green)
    colours = torch.where(avatar.rest_positions[:, 1:2] > 0.05, blue, colours)
    return avatar.replace(colours=colours, positions=avatar.positions + 0.01 * avatar.normals)


def film(avatar: Avatar, frames: int = 4, azimuth: float = 0.0) -> Views:
    """The avatar's motion as one camera sees it, with its own normals as maps."""
    puppet = Puppet(avatar, articulation(frames), toy.RASTER)
    T, p = toy.camera(azimuth), PINHOLE
    front = [puppet.render(t, T, p) for t in range(frames)]
    back = [puppet.render(t, T, p, side="back") for t in range(frames)]

    def image(planes: torch.Tensor) -> np.ndarray:
        return np.rint(255 * planes.clamp(0, 1).numpy()).astype(np.uint8)

    def maps(normal: torch.Tensor) -> np.ndarray:
        unit = torch.nn.functional.normalize(normal, dim=0).permute(1, 2, 0)
        return np.rint(127 * unit.numpy()).astype(np.int8)

    K = np.array([[p.fx, 0, p.cx], [0, p.fy, p.cy], [0, 0, 1]])
    crops = {
        "rgb": np.stack([image(r.colour / r.alpha.clamp_min(1e-3)).transpose(1, 2, 0) for r in front]),
        "alpha": np.stack([image(r.alpha) for r in front]),
        "K": np.stack([K] * frames),
        "T_cam_from_world": T.double().numpy(),
        "frame_index": np.arange(frames),
    }
    normals = {"front": np.stack([maps(r.normal) for r in front]), "back": np.stack([maps(r.normal) for r in back])}
    return Views.of(f"azimuth{math.degrees(azimuth):.0f}", crops, normals)
