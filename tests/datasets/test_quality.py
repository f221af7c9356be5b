"""Frame quality numbers on frames whose answer is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from soar.datasets.quality import FrameQuality


def measured(images: list[np.ndarray]) -> dict[str, float]:
    quality = FrameQuality()
    for image in images:
        quality.add(image)
    return {name: value for name, value, _ in quality.numbers()}


def test_known_frames():
    noise = np.random.default_rng(0).integers(0, 255, (80, 100, 3), np.uint8)
    blurred = cv2.GaussianBlur(noise, (0, 0), 3)
    numbers = measured([noise, noise, blurred, noise])
    assert numbers["repeated"] == 0.25
    assert numbers["sharpness_low"] < 0.5
    assert numbers["brightness"] == pytest.approx(0.5, abs=0.02)
    assert measured([np.full((40, 40, 3), 255, np.uint8)])["overexposed"] == 1
    assert measured([np.zeros((40, 40, 3), np.uint8)])["sharpness_low"] == 0


def test_resolution_hardly_matters():
    y, x = np.mgrid[0:1200, 0:1600]
    large = np.repeat((127 + 100 * np.sin(x / 30) * np.cos(y / 40))[..., None], 3, 2).astype(np.uint8)
    small = cv2.resize(large, (800, 600), interpolation=cv2.INTER_AREA)
    assert measured([large])["sharpness"] == pytest.approx(measured([small])["sharpness"], rel=0.1)
