"""What a dataset may know of a sequence besides its footage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from soar.body.motion import BodyMotion
from soar.geometry.cameras import Camera


class Truth(Protocol):
    """What a dataset knows of one sequence. Frames are numbers in its recordings; cameras are of the stored frames."""

    def body(self, frames: Sequence[int]) -> BodyMotion:
        """The body in motion at some frames."""

    def seen(self, camera: Camera, frame: int) -> np.ndarray:
        """(V,) bool: which vertices of the body a camera sees, clothes put aside."""

    def planes(self, camera: Camera, frame: int) -> dict[str, np.ndarray]:
        """Planes of a view by name, zero where nothing is.

        ``alpha``: (H, W) float32, share of the pixel that the clothed person covers. ``front``, ``back``: (H, W, 3)
        float32 normals of the clothed person, in the convention of :mod:`soar.perception.normals`. ``body_front``,
        ``body_back``: those of the naked body. ``depth``: (H, W) float32 z of the clothed person, metres.
        """
