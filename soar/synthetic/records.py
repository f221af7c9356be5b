"""The numbers that make a person, a garment and a light, in the order in which the native library reads them.

Every record is floats only (enumerations count as their number); :func:`pack` flattens one in the order of its fields,
which is that of the structs in ``soar/raster/native/people.h``. Colours are linear RGB, lengths metres on the mean
shape, heights along the body's up axis.
"""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import numpy as np

Colour = tuple[float, float, float]

LAYERS = ("body", "eyes", "trousers", "top", "jacket", "skirt", "shoes", "hair", "long_hair", "cap", "brim")
CLOTHS = LAYERS[2:]


class PatternKind(enum.IntEnum):
    """What repeats on a cloth."""

    PLAIN = 0
    HOOPS = 1
    PINSTRIPES = 2
    CHECKS = 3
    TWO_TONE = 4
    BLOTCHES = 5
    RAGLAN = 6
    MARL = 7
    DOTS = 8
    DIAGONAL = 9
    ZIGZAG = 10
    ARGYLE = 11
    FADE = 12
    HALVES = 13
    TILES = 14


class PrintKind(enum.IntEnum):
    """What is printed once."""

    NOTHING = 0
    NUMBER = 1
    DISC = 2
    STAR = 3
    RING = 4
    SQUARE = 5
    BAND = 6
    BADGE = 7
    HEART = 8
    TRIANGLE = 9
    CROSS = 10
    BOLT = 11
    SUN = 12
    FRAME = 13


@dataclasses.dataclass(frozen=True)
class Pattern:
    """Colours of a cloth.

    Attributes:
        kind: what repeats.
        period: length of the repeat.
        duty: share of the second colour in a repeat, or size of a dot.
        level: height at which two-tone cloth, raglan yokes and fades change.
        shade: how far the second colour is mixed in, 0 to 1.
        first, second, third: colours.
    """

    kind: PatternKind
    period: float
    duty: float
    level: float
    shade: float
    first: Colour
    second: Colour
    third: Colour


@dataclasses.dataclass(frozen=True)
class Print:
    """A motif on chest or back: kind, half its height, its middle's height, the number if it is one, colour."""

    kind: PrintKind
    size: float
    height: float
    index: float
    colour: Colour


NO_PRINT = Print(PrintKind.NOTHING, 0.1, 0.0, 0.0, (0.0, 0.0, 0.0))


@dataclasses.dataclass(frozen=True)
class Cloth:
    """One garment, a pair of shoes, hair or a cap.

    Attributes:
        worn: 1 or 0.
        thickness: distance from the surface it is cut from.
        flare, flare_range: how much farther it stands off at its loose end, and over which length that grows.
        bumps, bump_length: height and length of the uneven shape.
        low, high: heights of hem and waistband (or shoe top).
        sleeve: length along the arm from the shoulder.
        neck, neck_slope: height of the neckline below the neck, and how much higher it is behind per metre.
        vee: depth of a V at the front.
        strap: half width left between armholes; 0 for none.
        opening, spread: half width of the open front at the neck, and its growth per metre downwards.
        crease: height of folds; gloss: highlight; grain: contrast of the weave.
        rim, rim_width: how far hems, cuffs and neckline take the trim colour, and their width.
        collar: width of a collar.
        seams, pockets: contrast of seams; 1 for pockets.
        buttons: 1 buttons, 2 a zip.
        belt: width of a belt; sole: height of a sole; laces: 1 for laces.
        front, back: patterns of either side.
        chest, spine: prints of either side.
        trim, metal: colours of rims, belt and sole; of buckles, buttons, zips and laces.
        seed: offset of every noise.
    """

    worn: float
    thickness: float
    flare: float
    flare_range: float
    bumps: float
    bump_length: float
    low: float
    high: float
    sleeve: float
    neck: float
    neck_slope: float
    vee: float
    strap: float
    opening: float
    spread: float
    crease: float
    gloss: float
    grain: float
    rim: float
    rim_width: float
    collar: float
    seams: float
    pockets: float
    buttons: float
    belt: float
    sole: float
    laces: float
    front: Pattern
    back: Pattern
    chest: Print
    spine: Print
    trim: Colour
    metal: Colour
    seed: Colour


@dataclasses.dataclass(frozen=True)
class Person:
    """Skin, face, head of hair and clothes.

    Attributes:
        skin, lips, brows, iris, sock: colours.
        flush: redness of cheeks, nose, ears and hands; freckles, beard: strength.
        sock_top: height of the socks; below the ground for none.
        hairline: raises the front hairline; nape: lowers the rear one; ears: lowers hair over the ears,
            <= 0 leaves them.
        strands: raggedness and curl; fringe: how far below the crown a fringe hangs.
        hair_front: half width of the face left free by long hair.
        clothes: in the order of :data:`CLOTHS`.
    """

    skin: Colour
    lips: Colour
    brows: Colour
    iris: Colour
    sock: Colour
    flush: float
    freckles: float
    beard: float
    sock_top: float
    hairline: float
    nape: float
    ears: float
    strands: float
    fringe: float
    hair_front: float
    clothes: tuple[Cloth, ...]

    def cloth(self, name: str) -> Cloth:
        """The garment of layer ``name``."""
        return self.clothes[CLOTHS.index(name)]


@dataclasses.dataclass(frozen=True)
class Anchors:
    """Heights and places on the mean shape; x of the left half, which stands for both."""

    ground: float
    ankle: float
    knee: float
    crotch: float
    waist: float
    chest: float
    shoulder: float
    neck: float
    chin: float
    crown: float
    hip_x: float
    ankle_x: float
    neck_y: float
    ear_x: float
    ear_y: float
    ear_z: float
    eye: Colour
    brow: tuple[tuple[float, float], ...]
    lid_upper: tuple[tuple[float, float], ...]
    lid_lower: tuple[tuple[float, float], ...]
    lip: Colour
    lip_width: float
    lip_upper: float
    lip_lower: float
    nose: Colour
    arm: Colour


@dataclasses.dataclass(frozen=True)
class Light:
    """Soft light of the world.

    Attributes:
        sky: (9, 3) radiance as real spherical harmonics 1, y, z, x, xy, yz, 3z^2 - 1, xz, x^2 - y^2 of the normal.
        direction: unit, towards the key light.
        colour: of the key light.
        wrap: how far the key light reaches round an edge, 0 to 1.
        exposure: factor on everything.
    """

    sky: tuple[Colour, ...]
    direction: Colour
    colour: Colour
    wrap: float
    exposure: float


def pack(record: Any) -> np.ndarray:
    """The floats of a record in the order of its fields, float32."""
    out: list[float] = []
    _flatten(record, out)
    return np.array(out, np.float32)


def _flatten(value: Any, out: list[float]) -> None:
    if isinstance(value, (float, int)):
        out.append(value)
    else:
        # A dataclass keeps its fields in order of declaration.
        for item in value if isinstance(value, tuple) else vars(value).values():
            _flatten(item, out)
