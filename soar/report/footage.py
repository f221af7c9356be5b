"""What the videos show: settings, which frames, and their panels."""

from __future__ import annotations

import dataclasses
from typing import Literal

import cv2
import numpy as np

from soar.report.pictures import fit, grid, to_uint8
from soar.report.shots import Shot


@dataclasses.dataclass(frozen=True)
class TurntableSettings:
    """One turn of the avatar (``conf/render``); ``fov`` in degrees."""

    pose: Literal["frame", "canonical"]
    frame: float
    frames: int
    fps: float
    height: int
    fov: float
    margin: float


@dataclasses.dataclass(frozen=True)
class ViewSettings:
    """Videos through the sequence's own cameras (``conf/render``)."""

    height: int
    max_frames: int


@dataclasses.dataclass(frozen=True)
class RenderSettings:
    """The node ``render``."""

    turntable: TurntableSettings
    views: ViewSettings


def panels(*pictures: np.ndarray, height: int | None = None) -> np.ndarray:
    """Pictures of one size side by side, shrunk to ``height`` pixels if they are higher."""
    high = pictures[0].shape[0]
    if height is not None and height < high:
        width = round(pictures[0].shape[1] * height / high)
        pictures = tuple(fit(to_uint8(picture), width, height) for picture in pictures)
    return grid(pictures, len(pictures), gap=0)


def thinned(count: int, most: int) -> range:
    """Indices of at most ``most`` of ``count`` frames, evenly spaced from the first."""
    return range(0, count, -(-count // most))


def crack_share(shot: Shot, reach: int = 5) -> float:
    """Pixels less than half covered in gaps narrower than ``reach`` pixels, relative to the covered pixels.

    A closed surface has none; gaps between limbs are wider and do not count.
    """
    covered = np.pad((shot.alpha > 0.5).astype(np.uint8), reach)  # closing would join the surface to the border
    closed = cv2.morphologyEx(covered, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    return float((closed - covered).sum() / max(1, covered.sum()))
