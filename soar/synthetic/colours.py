"""Where the colours of people come from. Everything returned is linear RGB."""

from __future__ import annotations

import colorsys

import numpy as np

from soar.synthetic.records import Colour

# sRGB: skin from light to dark, after photographs' usual range; the natural colours of hair and iris.
_SKIN = np.array(
    [
        [0.93, 0.77, 0.68],
        [0.87, 0.67, 0.55],
        [0.76, 0.55, 0.42],
        [0.60, 0.41, 0.29],
        [0.44, 0.28, 0.19],
        [0.29, 0.18, 0.13],
    ]
)
_HAIR = {
    "black": (0.09, 0.08, 0.08), "dark": (0.18, 0.12, 0.09), "brown": (0.32, 0.21, 0.13), "chestnut": (0.40, 0.23,
    0.14),
    "blond": (0.75, 0.60, 0.37), "sand": (0.58, 0.46, 0.30), "red": (0.55, 0.25, 0.12), "grey": (0.55, 0.54, 0.53),
    "white": (0.85, 0.84, 0.81),
}  # fmt: skip
_IRIS = ((0.28, 0.17, 0.09), (0.20, 0.12, 0.07), (0.35, 0.45, 0.55), (0.36, 0.42, 0.28), (0.45, 0.40, 0.25))
_NEUTRAL = (
    (0.95, 0.95, 0.94), (0.85, 0.84, 0.82), (0.55, 0.55, 0.56), (0.30, 0.31, 0.33), (0.10, 0.10, 0.11), (0.82, 0.75,
        0.62),
    (0.60, 0.50, 0.38), (0.36, 0.27, 0.19), (0.12, 0.16, 0.28), (0.33, 0.36, 0.26),
)  # fmt: skip
_DENIM = ((0.16, 0.22, 0.35), (0.30, 0.40, 0.56), (0.52, 0.62, 0.74), (0.11, 0.13, 0.19), (0.22, 0.23, 0.25))


def linear(srgb: object) -> Colour:
    """sRGB in [0, 1] to linear."""
    c = np.clip(np.asarray(srgb, float), 0, 1)
    return tuple(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).tolist())


def _jittered(srgb: object, rng: np.random.Generator, amount: float) -> Colour:
    return linear(np.asarray(srgb) * (1 + rng.normal(0, amount)) + rng.normal(0, 0.4 * amount, 3))


def skin(rng: np.random.Generator) -> tuple[Colour, float]:
    """A skin colour and its darkness in [0, 1]."""
    darkness = float(rng.uniform())
    at = darkness * (len(_SKIN) - 1)
    tone = [np.interp(at, np.arange(len(_SKIN)), _SKIN[:, c]) for c in range(3)]
    return _jittered(tone, rng, 0.04), darkness


def lips(skin_colour: Colour, rng: np.random.Generator) -> Colour:
    """Redder and darker than the skin, now and then painted."""
    if rng.uniform() < 0.15:
        return linear((rng.uniform(0.5, 0.8), 0.12, 0.2))
    return tuple((np.array(skin_colour) * [0.80, 0.47, 0.47] * rng.uniform(0.8, 1.1)).tolist())


def hair(darkness: float, rng: np.random.Generator) -> tuple[Colour, Colour]:
    """Two tones of one head of hair."""
    if rng.uniform() < 0.04:
        base = colorsys.hsv_to_rgb(rng.uniform(), 0.7, 0.6)
    else:
        names = ["black", "dark", "grey", "white"] if darkness > 0.6 else list(_HAIR)
        base = _HAIR[names[rng.choice(len(names), p=_weights(len(names), darkness))]]
    return _jittered(base, rng, 0.10), _jittered(np.array(base) * rng.uniform(0.6, 1.35), rng, 0.05)


def _weights(count: int, darkness: float) -> np.ndarray:
    if count == 4:
        return np.array([0.6, 0.28, 0.08, 0.04])
    dark = np.array([0.18, 0.2, 0.18, 0.1, 0.1, 0.08, 0.05, 0.07, 0.04])
    return dark / dark.sum()


def iris(darkness: float, rng: np.random.Generator) -> Colour:
    """Brown for dark skin, anything for light skin."""
    return _jittered(_IRIS[rng.integers(2) if darkness > 0.45 else rng.integers(len(_IRIS))], rng, 0.1)


def cloth(rng: np.random.Generator) -> Colour:
    """Neutral or coloured, of any lightness."""
    if rng.uniform() < 0.5:
        return _jittered(_NEUTRAL[rng.integers(len(_NEUTRAL))], rng, 0.06)
    saturation = rng.triangular(0.15, 0.45, 0.9)
    value = rng.uniform(0.2, 1 - 0.3 * saturation)  # dyes: the more saturated, the darker
    return linear(colorsys.hsv_to_rgb(rng.uniform(), saturation, value))


def denim(rng: np.random.Generator) -> Colour:
    """A jeans colour."""
    return _jittered(_DENIM[rng.integers(len(_DENIM))], rng, 0.08)


def leather(rng: np.random.Generator) -> Colour:
    """Of shoes and belts."""
    palette = ((0.10, 0.09, 0.09), (0.28, 0.17, 0.10), (0.45, 0.28, 0.15), (0.88, 0.87, 0.85), (0.4, 0.4, 0.42))
    return _jittered(palette[rng.integers(len(palette))], rng, 0.08)


def contrasting(colour: Colour, rng: np.random.Generator) -> Colour:
    """A cloth colour that stands out from another."""
    best, gap = cloth(rng), -1.0
    for _ in range(4):
        other = cloth(rng)
        distance = float(np.abs(np.sqrt(other) - np.sqrt(colour)).sum())
        if distance > gap:
            best, gap = other, distance
        if gap > 0.7:
            break
    return best
