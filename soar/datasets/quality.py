"""Numbers that tell whether frames are worth working on: light, sharpness, repetitions."""

from __future__ import annotations

import cv2
import numpy as np

_LONG_SIDE = 480  # pixels of the grey thumbnails compared, so that the numbers do not depend on the resolution
_REPEATED = 0.1  # mean difference in grey levels of 255 below which a frame repeats the one before it


class FrameQuality:
    """Gathers numbers frame by frame; keeps one thumbnail."""

    def __init__(self) -> None:
        self._brightness: list[float] = []
        self._clipped: list[float] = []
        self._sharpness: list[float] = []
        self._repeated = 0
        self._last: np.ndarray | None = None

    def add(self, image: np.ndarray) -> None:
        """Measure one (H, W, 3) RGB uint8 frame."""
        scale = min(1.0, _LONG_SIDE / max(image.shape[:2]))
        size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
        grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        self._brightness.append(float(grey.mean()) / 255.0)
        self._clipped.append(float((grey >= 250).mean()))
        self._sharpness.append(float(cv2.Laplacian(grey, cv2.CV_32F).std()))
        if self._last is not None:
            self._repeated += bool(cv2.absdiff(grey, self._last).mean() < _REPEATED)
        self._last = grey

    def numbers(self) -> list[tuple[str, float, str]]:
        """Name, value and unit of what was measured.

        ``brightness``: mean grey in [0, 1]. ``overexposed``: share of pixels that are all but white. ``sharpness``:
        median deviation of the Laplacian, grey levels of 255. ``sharpness_low``: its 5th percentile in units of the
        median; far below 1 means that single frames are blurred. ``repeated``: share of frames equal to the one before.
        """
        sharpness = float(np.median(self._sharpness))
        low = float(np.percentile(self._sharpness, 5)) / sharpness if sharpness > 0 else 0.0
        return [
            ("brightness", float(np.mean(self._brightness)), ""),
            ("overexposed", float(np.mean(self._clipped)), ""),
            ("sharpness", sharpness, ""),
            ("sharpness_low", low, ""),
            ("repeated", self._repeated / len(self._brightness), ""),
        ]
