"""Colours as a whole: how they differ between cameras, how strong they are."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class ColourMap:
    """truth = gain * image + offset, per channel; gain and offset are (3,)."""

    gain: np.ndarray
    offset: np.ndarray

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Apply to (..., 3) colours, clipped to [0, 1]."""
        return np.clip(image * self.gain + self.offset, 0, 1)


def calibrate(pixels: np.ndarray, truth: np.ndarray) -> ColourMap:
    """Least-squares gain and offset per channel.

    Report metrics with and without it: it is fitted on the pixels it is judged by.

    Args:
        pixels: (P, 3) rendered colours.
        truth: (P, 3) photographed colours of the same pixels.

    Returns:
        the map; the identity for fewer than two pixels, an offset alone for a channel without contrast.
    """
    if len(pixels) < 2:
        return ColourMap(np.ones(3), np.zeros(3))
    x, y = np.asarray(pixels, np.float64), np.asarray(truth, np.float64)
    dx = x - x.mean(0)
    variance = (dx * dx).mean(0)
    flat = variance < 1e-10
    gain = np.where(flat, 1.0, (dx * (y - y.mean(0))).mean(0) / np.where(flat, 1.0, variance))
    return ColourMap(gain, y.mean(0) - gain * x.mean(0))


def saturation(colours: np.ndarray) -> float:
    """Mean spread of the channels, largest minus smallest, of colours (N, 3) in [0, 1]."""
    return float((colours.max(-1) - colours.min(-1)).mean())
