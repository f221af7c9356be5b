"""What a caption is made from, what it is, and what makes it."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from soar.body.record import BodyModel
from soar.raster import Pinhole


@dataclasses.dataclass(frozen=True)
class Sighting:
    """One photograph of the person, and where the body is in it.

    Attributes:
        camera: name.
        frame: index of the frame in its sequence.
        rgb: (H, W, 3) uint8 crop.
        alpha: (H, W) uint8 mask.
        vertices: (V, 3) the posed body in the camera's space, metres.
        pinhole: the crop's view.
    """

    camera: str
    frame: int
    rgb: np.ndarray
    alpha: np.ndarray
    vertices: Tensor
    pinhole: Pinhole


@dataclasses.dataclass(frozen=True)
class Footage:
    """What there is to be described: photographs of the person, at least one, spread evenly over a sequence."""

    sequence: str
    body: BodyModel
    sightings: tuple[Sighting, ...]


@dataclasses.dataclass(frozen=True)
class Swatch:
    """A colour that was measured: words for it, and sRGB in [0, 1]."""

    words: str
    colour: tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Caption:
    """The sentence, and what it rests on.

    Attributes:
        text: one sentence.
        evidence: what was measured or asked, as JSON.
        numbers: health numbers by name.
        remarks: sentences the user should read.
        swatches: the colours that were measured.
        pictures: (H, W, 3) one for each photograph, what was made of it.
    """

    text: str
    evidence: dict[str, Any]
    numbers: dict[str, float] = dataclasses.field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    swatches: tuple[Swatch, ...] = ()
    pictures: tuple[np.ndarray, ...] = ()


class CaptionProvider(Protocol):
    """Writes the caption of one sequence."""

    frames: int
    """Photographs it wants."""

    def caption(self, footage: Footage) -> Caption:
        """The caption of a sequence, from at most :attr:`frames` photographs."""
        ...
