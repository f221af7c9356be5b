"""A person drawn from a family and a seed: the shape of the body, skin, face, hair and clothes."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping

import numpy as np

from soar.errors import ConfigError
from soar.synthetic import colours, garments
from soar.synthetic.garments import NOT_WORN, tailored
from soar.synthetic.records import (
    CLOTHS,
    NO_PRINT,
    Anchors,
    Cloth,
    Colour,
    Pattern,
    PatternKind,
    Person,
    Print,
    PrintKind,
)
from soar.synthetic.settings import FamilySettings, SubjectSettings


def generator(family: str, seed: int, purpose: str = "") -> np.random.Generator:
    """The random numbers of one person; those of families, seeds and purposes are independent of each other."""
    return np.random.default_rng([zlib.crc32(f"{family}/{purpose}".encode()), seed])


@dataclasses.dataclass(frozen=True)
class Subject:
    """One person.

    Attributes:
        family, seed: what drew it.
        betas: (B,) shape of the body.
        person: the numbers that the renderer reads.
        outfit: names of what is worn, by part: top, bottom, jacket, footwear, hair.
    """

    family: str
    seed: int
    betas: np.ndarray
    person: Person
    outfit: Mapping[str, str]

    @staticmethod
    def draw(family: str, seed: int, anchors: Anchors, components: int, settings: SubjectSettings) -> Subject:
        """The person of this family and seed.

        Raises:
            ConfigError: there is no such family, or it names a garment, pattern or print that does not exist.
        """
        if family not in settings.families:
            raise ConfigError("unknown family of people", expected=", ".join(settings.families), got=family)
        return _Tailor(generator(family, seed), anchors, settings, settings.families[family]).subject(
            family, seed, components
        )


def _pick(weights: Mapping[str, float], rng: np.random.Generator, known: object) -> str:
    names = sorted(weights)  # the order in a configuration file says nothing
    unknown = sorted(set(names) - set(known))  # type: ignore[call-overload]
    if unknown:
        raise ConfigError("unknown name in a family", expected=", ".join(known), got=unknown[0])  # type: ignore[call-overload]
    p = np.array([weights[name] for name in names], float)
    return names[rng.choice(len(names), p=p / p.sum())]


class _Tailor:
    """Draws the parts of one person in a fixed order."""

    def __init__(
        self, rng: np.random.Generator, anchors: Anchors, settings: SubjectSettings, family: FamilySettings
    ) -> None:
        self.rng, self.anchors, self.settings, self.family = rng, anchors, settings, family

    def subject(self, family: str, seed: int, components: int) -> Subject:
        rng, wear = self.rng, self.family
        limit = self.settings.beta_limit
        betas = np.clip(rng.normal(size=components), -limit, limit).astype(np.float32)
        skin, darkness = colours.skin(rng)
        tones = colours.hair(darkness, rng)
        outfit = {
            "top": _pick(wear.tops, rng, garments.TOPS),
            "bottom": _pick(wear.bottoms, rng, garments.BOTTOMS),
            "jacket": _pick(wear.jackets, rng, garments.JACKETS),
            "footwear": _pick(wear.footwear, rng, garments.FOOTWEAR),
            "hair": _pick(wear.hair, rng, garments.HAIR),
        }
        clothes = dict.fromkeys(CLOTHS, NOT_WORN)
        clothes |= self._trunk(outfit) | self._feet(outfit["footwear"]) | self._head(outfit["hair"], tones)
        socks = outfit["footwear"] not in ("bare", "socks") and rng.uniform() < 0.6
        height = rng.uniform(0.02, 0.22) if rng.uniform() < 0.8 else rng.uniform(0.28, 0.4)
        covers = outfit["hair"] in ("bob", "long", "waves")
        person = Person(
            skin=skin,
            lips=colours.lips(skin, rng),
            brows=tuple((np.array(tones[0]) * 0.6).tolist()),
            iris=colours.iris(darkness, rng),
            sock=colours.cloth(rng),
            flush=float(rng.uniform(0.2, 0.9)),
            freckles=float(max(0.0, rng.uniform(-1.5, 0.35)) if darkness < 0.4 else 0.0),
            beard=float(rng.uniform(0.15, 0.9)) if rng.uniform() < self.settings.beard and not covers else 0.0,
            sock_top=self.anchors.ankle + height if socks else self.anchors.ground - 1.0,
            hairline=float(rng.uniform(0.035, 0.06) if outfit["hair"] == "receding" else rng.uniform(-0.008, 0.012)),
            nape=float(0.05 if covers else rng.uniform(-0.015, 0.015)),
            ears=float(rng.uniform(0.03, 0.05) if covers or outfit["hair"] == "afro" else 0.0),
            strands=float(rng.uniform(0.6, 1.0) if outfit["hair"] == "afro" else rng.uniform(0.1, 0.6)),
            fringe=float(rng.uniform(0.02, 0.07)),
            hair_front=float(rng.uniform(0.058, 0.075)),
            clothes=tuple(clothes[name] for name in CLOTHS),
        )
        return Subject(family, seed, betas, person, outfit)

    # colours

    def _pattern(self, base: Colour, plain: float) -> Pattern:
        rng = self.rng
        kinds = {kind.name.lower(): kind for kind in PatternKind}
        kind = PatternKind.PLAIN if rng.uniform() < plain else kinds[_pick(self.family.patterns, rng, kinds)]
        other = colours.contrasting(base, rng)
        period = {
            PatternKind.PINSTRIPES: (0.014, 0.05), PatternKind.CHECKS: (0.035, 0.11), PatternKind.BLOTCHES: (0.05,
                0.14),
            PatternKind.DOTS: (0.025, 0.07), PatternKind.ARGYLE: (0.08, 0.14), PatternKind.TILES: (0.05, 0.14),
        }.get(kind, (0.025, 0.10))  # fmt: skip
        level = {
            PatternKind.RAGLAN: (self.anchors.shoulder + 0.03, self.anchors.shoulder + 0.06),
        }.get(kind, (self.anchors.waist, self.anchors.chest + 0.06))  # fmt: skip
        return Pattern(
            kind, float(rng.uniform(*period)), float(rng.uniform(0.25, 0.6)), float(rng.uniform(*level)),
            float(rng.uniform(0.55, 1.0)), base, other, colours.cloth(rng),
        )  # fmt: skip

    def _sides(self, base: Colour, plain: float, panel: float) -> tuple[Pattern, Pattern]:
        front = self._pattern(base, plain)
        if self.rng.uniform() >= panel:
            return front, front
        if self.rng.uniform() < 0.5:
            return front, self._pattern(base if front.kind else colours.contrasting(base, self.rng), plain)
        return front, self._pattern(colours.contrasting(base, self.rng), 1.0)

    def _print(self, share: float, on: Colour, height: float, size: tuple[float, float], numbers: float) -> Print:
        rng = self.rng
        if rng.uniform() >= share:
            return NO_PRINT
        kinds = {kind.name.lower(): kind for kind in PrintKind if kind is not PrintKind.NOTHING}
        low, high = self.family.numbers
        numbered = rng.uniform() < numbers
        kind = PrintKind.NUMBER if numbered else kinds[_pick(self.family.prints, rng, kinds)]
        return Print(
            kind, float(rng.uniform(*size)), float(height + rng.uniform(-0.05, 0.03)), float(rng.integers(low,
                high + 1)),
            colours.contrasting(on, rng),
        )  # fmt: skip

    def _cloth(self, cut: garments.Cut, base: Colour, plain: float, panel: float = 0.0, **fields: object) -> Cloth:
        rng = self.rng
        front, back = self._sides(base, plain, panel)
        values = {
            "front": front, "back": back, "trim": colours.contrasting(base, rng),
            "metal": colours.linear(rng.uniform(0.5, 0.9) * np.ones(3)),
            "crease": float(rng.uniform(*self.settings.crease)),
        }  # fmt: skip
        return tailored({"bump_length": (0.06, 0.16), **cut}, self.anchors, rng, **{**values, **fields})

    # parts

    def _trunk(self, outfit: Mapping[str, str]) -> dict[str, Cloth]:
        rng, a = self.rng, self.anchors
        clothes: dict[str, Cloth] = {}
        name = outfit["bottom"]
        below = colours.denim(rng) if name == "jeans" else colours.cloth(rng)
        plain = 0.9 if name == "jeans" else 0.65
        skirt = name in garments.SKIRTS
        bottom = self._cloth(
            garments.BOTTOMS[name], below, plain, 0.2 * self.settings.back_panel, trim=colours.leather(rng)
        )
        clothes["skirt" if skirt else "trousers"] = bottom
        top = garments.TOPS[outfit["top"]]
        if top is not None:
            base = below if skirt and rng.uniform() < 0.3 else colours.cloth(rng)
            chest = self._print(self.settings.chest_print, base, a.chest - 0.02, (0.045, 0.085), 0.2)
            spine = self._print(self.settings.spine_print, base, a.chest + 0.01, (0.07, 0.13), 0.5)
            cloth = self._cloth(top, base, 0.35, self.settings.back_panel, chest=chest, spine=spine)
            tucked = skirt or rng.uniform() < 0.25
            if tucked and outfit["top"] != "crop":
                cloth = dataclasses.replace(
                    cloth, low=bottom.high - 0.02, flare=0.0, bumps=0.001, thickness=0.003, rim=0.0, rim_width=0.0
                )
            clothes["top"] = cloth
        jacket = garments.JACKETS[outfit["jacket"]]
        if jacket is not None and top is not None:
            base = colours.cloth(rng)
            closed = not jacket.get("opening")
            chest = self._print(
                0.3 * self.settings.chest_print if closed else 0.0, base, a.chest - 0.02, (0.04, 0.07), 0.0
            )
            spine = self._print(self.settings.spine_print, base, a.chest + 0.01, (0.07, 0.13), 0.2)
            clothes["jacket"] = self._cloth(jacket, base, 0.7, self.settings.back_panel, chest=chest, spine=spine)
        return clothes

    def _feet(self, name: str) -> dict[str, Cloth]:
        cut = garments.FOOTWEAR[name]
        if cut is None:
            return {}
        rng = self.rng
        base = colours.cloth(rng) if name in ("trainers", "socks") else colours.leather(rng)
        sole = colours.linear((0.92, 0.92, 0.90)) if rng.uniform() < 0.5 else colours.leather(rng)
        return {
            "shoes": self._cloth(cut, base, 0.85, trim=sole, metal=colours.linear(rng.uniform(0.2, 0.95) * np.ones(3)))
        }

    def _head(self, name: str, tones: tuple[Colour, Colour]) -> dict[str, Cloth]:
        rng, clothes = self.rng, {}
        cut = garments.HAIR[name]
        if cut is not None:
            pattern = Pattern(PatternKind.PLAIN, 1.0, 0.5, 0.0, float(rng.uniform(0.3, 1.0)), *tones, tones[1])
            for layer, table in (("hair", garments.HAIR), ("long_hair", garments.LOCKS)):
                if table.get(name) is not None:
                    clothes[layer] = self._cloth(table[name], tones[0], 1.0, front=pattern, back=pattern)
        if name in garments.CAPS:
            clothes["cap"] = self._cloth(garments.CAPS[name], colours.cloth(rng), 0.7)
            if name == "cap":
                clothes["brim"] = clothes["cap"]
        return clothes
