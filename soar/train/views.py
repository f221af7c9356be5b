"""Random cameras around a person, and the window of the picture that holds them: what the stage ``crops`` would cut."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.raster import Pinhole
from soar.synthetic.scene import Shot


@dataclasses.dataclass(frozen=True)
class ViewSettings:
    """Where cameras stand and how much of the window the person fills; drawn uniformly.

    Attributes:
        distance: (least, most) metres from the person.
        elevation: (least, most) degrees above the person's level.
        roll: largest turn about the optical axis, degrees.
        aside: largest tangent of the angle between the optical axis and the person, across and down.
        share: (least, most) share of the window, whichever of height and width is nearer, that the person fills.
        half: share of windows that show only a part of the person.
        part: (least, most) share of the person's height that those show.
    """

    distance: tuple[float, float]
    elevation: tuple[float, float]
    roll: float
    aside: tuple[float, float]
    share: tuple[float, float]
    half: float
    part: tuple[float, float]


def random_shot(
    rng: np.random.Generator, points: np.ndarray, up: np.ndarray, height: int, width: int, settings: ViewSettings
) -> Shot:
    """A view of a person from anywhere around.

    Args:
        rng: draws everything.
        points: (V, 3) the person, metres, world.
        up: (3,) unit vector away from the ground.
        height, width: of the window, pixels.
        settings: see :class:`ViewSettings`.
    """
    rotation = _orientation(rng, up, settings)
    distance, aside = rng.uniform(*settings.distance), rng.uniform(-1, 1, 2) * settings.aside
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = distance * np.array([*aside, 1.0]) - rotation @ ((points.min(0) + points.max(0)) / 2)
    seen = points @ rotation.T + T[:3, 3]
    flat = seen[:, :2] / seen[:, 2:]
    low, high = flat.min(0), flat.max(0)
    share = rng.uniform(*settings.share)
    if rng.uniform() < settings.half:
        part = rng.uniform(*settings.part)
        low[1] += rng.uniform(0, 1 - part) * (high - low)[1]
        high[1] = low[1] + part * (flat[:, 1].max() - flat[:, 1].min())
        pixel = (high - low)[1] / height  # tangent per pixel; arms may leave the window
    else:
        pixel = max((high - low) / [width, height]) / share
    room = [width, height] - (high - low) / pixel
    corner = np.where(room > 0, rng.uniform(0.2, 0.8, 2), 0.5) * room
    cx, cy = corner - low / pixel
    return Shot(Pinhole(1 / pixel, 1 / pixel, cx, cy, width, height), T)


def _orientation(rng: np.random.Generator, up: np.ndarray, settings: ViewSettings) -> np.ndarray:
    """(3, 3) world to camera (x right, y down, z forward), from some azimuth, elevation and roll."""
    elevation, azimuth = np.deg2rad(rng.uniform(*settings.elevation)), rng.uniform(0, 2 * np.pi)
    level = np.linalg.svd(up[None])[2][1:]  # two directions along the ground
    away = np.cos(azimuth) * level[0] + np.sin(azimuth) * level[1]
    forward = -np.cos(elevation) * away - np.sin(elevation) * up
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    roll = np.deg2rad(rng.uniform(-1, 1) * settings.roll)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return turn @ np.stack([right, np.cross(forward, right), forward])
