"""Soft light: a sky in spherical harmonics up to order two and one key light."""

from __future__ import annotations

import colorsys
import math

import numpy as np

from soar.synthetic.records import Light
from soar.synthetic.settings import LightSettings


def draw_light(rng: np.random.Generator, settings: LightSettings) -> Light:
    """A light of the world, whose up is +z; the key light may come from any side."""
    tint = lambda: np.array(colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(0, settings.tint), 1.0))  # noqa: E731
    sky = np.zeros((9, 3))
    ambient = rng.uniform(*settings.ambient)
    sky[0] = ambient * tint()
    # Brighter from above than from below, and from one side than from the other; higher orders are weaker once the
    # cosine lobe has smoothed them (Ramamoorthi and Hanrahan 2001).
    sky[2] = ambient * rng.uniform(0.05, 0.35) * tint()
    sky[[1, 3]] = ambient * rng.normal(0, 1, (2, 1)) * rng.uniform(*settings.gradient) * 0.5 * tint()
    sky[4:] = ambient * rng.normal(0, 1, (5, 1)) * rng.uniform(*settings.gradient) * 0.15 * tint()
    elevation, azimuth = math.radians(rng.uniform(*settings.elevation)), rng.uniform(0, 2 * math.pi)
    direction = (math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation))
    key = rng.uniform(*settings.key)
    # A photographer exposes for the sum of both.
    exposure = 0.85 / (ambient + 0.45 * key)
    return Light(
        tuple(map(tuple, sky.tolist())), direction, tuple((key * tint()).tolist()), float(rng.uniform(*settings.wrap)),
        float(exposure * rng.uniform(0.8, 1.2)),
    )  # fmt: skip
