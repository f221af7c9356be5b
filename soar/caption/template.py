"""A caption from measured colours: which parts of the body are bare, how far clothes reach, what colours they have."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np

from soar.caption.colours import ColourNames, PaletteSettings, Tone, lab, main_tones, srgb
from soar.caption.person import Person, SkinSettings
from soar.caption.records import Caption, Footage, Swatch
from soar.caption.regions import ARMS, LEGS, REGIONS, RegionFinder
from soar.raster import RasterSettings


@dataclasses.dataclass(frozen=True)
class LengthSettings:
    """What a garment is called by how far down the limb it reaches."""

    sleeveless: float
    short_sleeved: float
    briefs: float
    shorts: float
    cropped: float


@dataclasses.dataclass(frozen=True)
class TemplateSettings:
    """Node ``caption`` with the provider ``template``; ``conf/caption/template.yaml`` tells what the fields mean."""

    provider: Literal["template"]
    frames: int
    margin: float
    reach: float
    min_share: float
    skin: SkinSettings
    bald: SkinSettings
    lengths: LengthSettings
    palette: PaletteSettings
    name_lightness: float
    colours: dict[str, tuple[tuple[int, int, int], ...]]
    hair: dict[str, str]


@dataclasses.dataclass(frozen=True)
class Part:
    """What was found on a part of the person.

    Attributes:
        words: what the caption says of it.
        regions: those that show it.
        tones: its main colours, the commonest first.
        reach: how far down the limb it goes, 0 to 1; None where that is not known.
    """

    words: str
    regions: tuple[str, ...]
    tones: tuple[Tone, ...]
    reach: float | None = None


class Template:
    """Describes head, top, legwear and feet. It tells garments by their colours alone, hence no skirt from trousers."""

    def __init__(self, options: TemplateSettings, raster: RasterSettings) -> None:
        self.options, self.backend, self.frames = options, raster.backend, options.frames
        self._name = ColourNames(options.colours, options.name_lightness)

    def caption(self, footage: Footage) -> Caption:
        """See :class:`soar.caption.records.CaptionProvider`."""
        find = RegionFinder(footage.body, self.options.margin, self.options.reach, self.backend)
        maps = [find(sighting) for sighting in footage.sightings]
        person = Person(self._pixels(footage, maps), self.options.skin)
        parts = {"head": self._head, "upper": self._upper, "lower": self._lower, "feet": self._feet}
        found = {name: part for name, describe in parts.items() if (part := describe(person)) is not None}
        return Caption(
            text=sentence([part.words for part in found.values()]),
            evidence={name: self._record(part) for name, part in found.items()} | {"skin": person.skin.tolist()},
            numbers={"parts": len(found)},
            remarks=tuple(_remarks(person, parts.keys() - found.keys())),
            swatches=tuple(Swatch(part.words, srgb(tone.colour)) for part in found.values() for tone in part.tones),
            pictures=tuple(_painted(regions, person, found.values()) for regions in maps),
        )

    def _pixels(self, footage: Footage, maps: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Colours of the regions that are seen well enough."""
        colours = [lab(sighting.rgb) for sighting in footage.sightings]
        pixels = {
            region: np.concatenate([colour[where == index] for colour, where in zip(colours, maps, strict=True)])
            for index, region in enumerate(REGIONS)
        }
        enough = self.options.min_share * sum(map(len, pixels.values()))
        return {region: found for region, found in pixels.items() if len(found) > enough}

    def _head(self, person: Person) -> Part | None:
        region = "top of head"
        if region not in person.pixels:
            return None
        tones = self._tones(person.pixels[region])
        if person.bare(region, self.options.bald):
            return Part("a bald head", (region,), tones)
        name = self._name(tones[0].colour)
        hair = self.options.hair.get(name)
        return Part(f"{hair} hair" if hair else with_article(f"{name} cap"), (region,), tones[:1])

    def _upper(self, person: Person) -> Part | None:
        trunk = tuple(region for region in ("chest", "belly") if region in person.pixels)
        if not trunk:
            return None
        if person.bare(trunk[0]):
            return Part("bare-chested", trunk[:1], self._tones(person.cloth(trunk[:1])))
        worn = tuple(region for region in trunk if not person.bare(region))
        bands, reach = person.covered(ARMS)
        tones, lengths = self._tones(person.cloth(worn)), self.options.lengths
        sleeves = ""
        if reach is not None:
            limits = {"sleeveless": lengths.sleeveless, "short-sleeved": lengths.short_sleeved}
            sleeves = next((word for word, limit in limits.items() if reach < limit), "long-sleeved") + " "
        garment = "top" if worn == trunk else "cropped top"
        return Part(with_article(f"{sleeves}{self._names(tones)} {garment}"), worn + bands, tones, reach)

    def _lower(self, person: Person) -> Part | None:
        seen = tuple(region for region in ("hips", *LEGS) if region in person.pixels)
        worn, reach = person.covered(LEGS)
        # Above bare thighs and below a covered belly, cloth is the hem of a top.
        if "hips" in seen and not person.bare("hips") and (worn or ("belly" in person.pixels and person.bare("belly"))):
            worn = ("hips", *worn)
        if not worn:
            return Part("bare legs", seen, self._tones(person.cloth(seen))) if seen else None
        tones, lengths = self._tones(person.cloth(worn)), self.options.lengths
        kind = "legwear"
        if reach is not None:
            limits = {"briefs": lengths.briefs, "shorts": lengths.shorts, "cropped trousers": lengths.cropped}
            kind = next((word for word, limit in limits.items() if reach < limit), "trousers")
        return Part(f"{self._names(tones)} {kind}", worn, tones, reach)

    def _feet(self, person: Person) -> Part | None:
        if "feet" not in person.pixels:
            return None
        tones = self._tones(person.pixels["feet"])
        return Part("bare feet" if person.bare("feet") else f"{self._names(tones)} shoes", ("feet",), tones)

    def _tones(self, pixels: np.ndarray) -> tuple[Tone, ...]:
        return main_tones(pixels, self.options.palette)

    def _names(self, tones: Sequence[Tone]) -> str:
        return " and ".join(dict.fromkeys(self._name(tone.colour) for tone in tones))

    def _record(self, part: Part) -> dict[str, Any]:
        tones = [{"name": self._name(t.colour), "lab": t.colour.tolist(), "share": t.share} for t in part.tones]
        return {"words": part.words, "regions": part.regions, "colours": tones, "reach": part.reach}


def with_article(words: str) -> str:
    """The words after "a" or "an"."""
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


def sentence(words: Sequence[str]) -> str:
    """The caption of a person of whom this is to be said."""
    if not words:
        return "A person."
    joint = ", " if words[0] == "bare-chested" else " with "
    return f"A person{joint}{', '.join(words)}."


def _remarks(person: Person, missing: Iterable[str]) -> Iterable[str]:
    for name in sorted(missing):
        yield f"The caption says nothing of the {name} of the person: no photograph shows enough of it."
    if not len(person.skin):
        yield "Neither face nor hands show skin, so all is taken for clothes; caption=text can do better."


def _painted(regions: np.ndarray, person: Person, parts: Iterable[Part]) -> np.ndarray:
    """(H, W, 3) every region in the main colour of what was found on it; white where nothing was measured."""
    palette = np.ones((len(REGIONS) + 1, 3))  # the last is NOWHERE
    for index, region in enumerate(REGIONS):
        if region in person.pixels:
            palette[index] = srgb(np.median(person.pixels[region], axis=0))
    for part in parts:
        for region in part.regions:
            palette[REGIONS.index(region)] = srgb(part.tones[0].colour)
    return palette[regions]
