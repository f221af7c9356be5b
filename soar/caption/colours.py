"""Colours of cloth and skin in CIELAB (D65): the main ones of many pixels, their names, and what shading does to them.

Shading scales linear RGB. Above black L* + 16, a* and b* are proportional to cube roots of linear values, hence scale
together: a* / (L* + 16) and b* / (L* + 16) tell a material in light and shade alike.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

_OFFSET = 16.0
_COMMON = 60.0  # L* at which shaded colours are compared
_ROUNDS = 10
_ENOUGH = 20_000  # pixels to find main colours from


def lab(rgb: np.ndarray) -> np.ndarray:
    """(..., 3) L* in [0, 100], a*, b* of sRGB, uint8 or float in [0, 1]."""
    scaled = rgb.astype(np.float32) / 255 if rgb.dtype == np.uint8 else rgb.astype(np.float32)
    return cv2.cvtColor(scaled.reshape(1, -1, 3), cv2.COLOR_RGB2Lab).reshape(rgb.shape)


def srgb(colour: np.ndarray) -> tuple[float, float, float]:
    """sRGB in [0, 1] of one L*, a*, b*."""
    rgb = cv2.cvtColor(np.float32(colour).reshape(1, 1, 3), cv2.COLOR_Lab2RGB).clip(0, 1)
    return tuple(rgb[0, 0].tolist())


def evenly_lit(colours: np.ndarray) -> np.ndarray:
    """(..., 2) a*, b* that colours (..., 3) would have at one common lightness."""
    return colours[..., 1:] * ((_COMMON + _OFFSET) / (colours[..., :1] + _OFFSET))


def exposure(colours: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(...) how much brighter (cube root of the light) colours (..., 3) are than a reference (3,) of their material."""
    return (colours[..., 0] + _OFFSET) / (reference[0] + _OFFSET)


@dataclasses.dataclass(frozen=True)
class PaletteSettings:
    """How many colours something has (``conf/caption/template.yaml``)."""

    groups: int
    apart: float
    lightness: float
    second: float


@dataclasses.dataclass(frozen=True)
class Tone:
    """One of the main colours: L*, a*, b* (3,) and its share of the pixels."""

    colour: np.ndarray
    share: float


def main_tones(pixels: np.ndarray, settings: PaletteSettings) -> tuple[Tone, ...]:
    """The one or two main colours of pixels (N, 3) in L*, a*, b*, the commonest first.

    k-means, with lightness counting less than chroma, for shading changes it; groups nearer than ``apart`` are one.
    The second colour must have a share of ``second``.
    """
    pixels = pixels[:: -(-len(pixels) // _ENOUGH)]
    points = pixels * np.array([settings.lightness, 1, 1])
    middle = points - points.mean(0)
    axis = np.linalg.eigh(middle.T @ middle)[1][:, -1]
    ranked = points[np.argsort(middle @ axis, kind="stable")]
    centres = np.stack([part.mean(0) for part in np.array_split(ranked, min(settings.groups, len(ranked)))])
    for _ in range(_ROUNDS):
        label = _nearest(points, centres)
        centres = np.stack([points[label == k].mean(0) for k in np.unique(label)])
    label = _nearest(points, centres)
    groups = [np.flatnonzero(label == k) for k in np.unique(label)]
    while len(groups) > 1:
        means = np.stack([points[group].mean(0) for group in groups])
        gaps = np.linalg.norm(means[:, None] - means, axis=-1) + np.diag(np.full(len(groups), np.inf))
        i, j = sorted(np.unravel_index(gaps.argmin(), gaps.shape))
        if gaps[i, j] >= settings.apart:
            break
        groups[i] = np.concatenate([groups[i], groups.pop(j)])
    tones = [Tone(np.median(pixels[group], axis=0), len(group) / len(pixels)) for group in groups]
    first, *others = sorted(tones, key=lambda tone: -tone.share)
    return (first, *(tone for tone in others[:1] if tone.share >= settings.second))


def _nearest(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(N,) index of the nearest centre."""
    return (((points[:, None] - centres) ** 2).sum(-1)).argmin(1)


class ColourNames:
    """Plain words for colours: that of the nearest example.

    Args:
        examples: word -> sRGB triples in 0..255.
        lightness: how much a difference in L* counts beside one in chroma.
    """

    def __init__(self, examples: Mapping[str, Sequence[Sequence[int]]], lightness: float) -> None:
        self._words = [word for word, colours in examples.items() for _ in colours]
        listed = [colour for colours in examples.values() for colour in colours]
        self._scale = np.array([lightness, 1, 1])
        self._examples = lab(np.array(listed, np.float32) / 255) * self._scale

    def __call__(self, colour: np.ndarray) -> str:
        """The word for one L*, a*, b*."""
        return self._words[int(_nearest(colour[None] * self._scale, self._examples)[0])]
