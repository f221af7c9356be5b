"""The colours of one person by region of the body, and which of them are skin."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from soar.caption.colours import evenly_lit, exposure
from soar.caption.regions import BANDS

_LATEST = 2  # bands that may be bare before a garment begins


@dataclasses.dataclass(frozen=True)
class SkinSettings:
    """What is skin (``conf/caption/template.yaml``)."""

    tolerance: float
    yellow: float
    exposure: tuple[float, float]
    bare: float


class Person:
    """What the photographs show of a person.

    Args:
        pixels: region -> (N, 3) L*, a*, b* of the pixels that show it; a region that is not seen is not there.
        settings: what is skin.

    Attributes:
        skin: (S, 3) colours of the person's skin: of the face, and of the hands where they are like it or no face is
            seen; none where neither is seen, or neither has the hue of skin.
    """

    def __init__(self, pixels: Mapping[str, np.ndarray], settings: SkinSettings) -> None:
        self.pixels, self._settings = pixels, settings
        self.skin = np.empty((0, 3))
        for region in ("face", "hands"):
            if region in pixels:
                colour = np.median(pixels[region], axis=0)
                # All skin is reddish and yellowish; masks of other hues are told by that, and gloves by the face.
                if (colour[1:] > 0).all() and (not len(self.skin) or self.is_skin(colour[None])[0]):
                    self.skin = np.concatenate([self.skin, colour[None]])

    def is_skin(self, pixels: np.ndarray, settings: SkinSettings | None = None) -> np.ndarray:
        """(N,) whether colours (N, 3) are the person's skin, lit or shaded; by other settings than usual if given."""
        settings = settings or self._settings
        found, scale = np.zeros(len(pixels), bool), np.array([1, settings.yellow])
        darkest, brightest = settings.exposure
        for colour in self.skin:
            away = np.linalg.norm((evenly_lit(pixels) - evenly_lit(colour)) * scale, axis=-1)
            light = exposure(pixels, colour)
            found |= (away < settings.tolerance) & (light > darkest) & (light < brightest)
        return found

    def bare(self, region: str, settings: SkinSettings | None = None) -> bool:
        """Whether a region that is seen is mostly skin; by other settings than usual if given."""
        return bool(self.is_skin(self.pixels[region], settings).mean() > (settings or self._settings).bare)

    def cloth(self, regions: Sequence[str]) -> np.ndarray:
        """(N, 3) what is not skin in some regions; all of it where that is everything."""
        pixels = np.concatenate([self.pixels[region] for region in regions])
        covered = ~self.is_skin(pixels)
        return pixels[covered] if covered.any() else pixels

    def covered(self, bands: Sequence[str]) -> tuple[tuple[str, ...], float | None]:
        """The bands of a limb that a garment covers, without those not seen, and how far down it goes.

        The garment begins at one of the first bands, for what hangs over these may have the colour of skin, and ends at
        the first bare one after that. 0 is the top of the limb, 1 its end. It is None where the limb leaves the picture
        before the garment ends, or nobody knows what is skin.
        """
        worn: list[str] = []
        for index, band in enumerate(bands):
            if band not in self.pixels:
                continue
            if not self.bare(band):
                worn.append(band)
            elif worn or index >= _LATEST:
                return tuple(worn), index / BANDS if worn else 0.0
        return tuple(worn), 1.0 if len(self.skin) and set(worn) & set(bands[-2:]) else None
