"""Settings of synthetic people (node ``synthetic``). Every pair is a lowest and a highest value, drawn uniformly."""

from __future__ import annotations

import dataclasses

Range = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class FamilySettings:
    """What one family of people may wear; a name is drawn with its weight.

    Attributes:
        tops, bottoms, jackets, footwear, hair: weights by name in :mod:`soar.synthetic.garments`.
        patterns, prints: weights by name of :class:`~soar.synthetic.records.PatternKind` and ``PrintKind``.
        numbers: lowest and highest number on a shirt.
    """

    tops: dict[str, float]
    bottoms: dict[str, float]
    jackets: dict[str, float]
    footwear: dict[str, float]
    hair: dict[str, float]
    patterns: dict[str, float]
    prints: dict[str, float]
    numbers: tuple[int, int]


@dataclasses.dataclass(frozen=True)
class SubjectSettings:
    """How people are drawn.

    Attributes:
        beta_limit: shapes are normal with one standard deviation per component, cut at this many.
        chest_print, spine_print: share of tops with a motif in front, behind.
        back_panel: share of tops and trousers whose back has another colour or pattern.
        beard: share of people with stubble or beard.
        crease: height of folds, metres.
        families: what each family wears.
    """

    beta_limit: float
    chest_print: float
    spine_print: float
    back_panel: float
    beard: float
    crease: Range
    families: dict[str, FamilySettings]


@dataclasses.dataclass(frozen=True)
class LightSettings:
    """Soft light.

    Attributes:
        key: radiance of the key light; ambient: of the sky.
        elevation: of the key light above the horizon, degrees.
        gradient: how uneven the sky is, as a share of its mean.
        tint: how far either light is coloured.
        wrap: softness of the key light.
    """

    key: Range
    ambient: Range
    elevation: Range
    gradient: Range
    tint: float
    wrap: Range


@dataclasses.dataclass(frozen=True)
class PoseSettings:
    """Poses and motions.

    Attributes:
        weights: how often each kind of pose is drawn, by name in :mod:`soar.synthetic.poses`.
        variation: standard deviation added to every angle, degrees.
        clearance: how deep, metres, limbs may press into trunk, head or each other.
        attempts: draws, each relaxed in four steps, before one is taken as it is.
    """

    weights: dict[str, float]
    variation: float
    clearance: float
    attempts: int


@dataclasses.dataclass(frozen=True)
class RenderSettings:
    """The renderer.

    Attributes:
        samples: samples per side of a pixel.
        subdivisions: how often the garments' triangles are halved.
    """

    samples: int
    subdivisions: int


@dataclasses.dataclass(frozen=True)
class SyntheticSettings:
    """Node ``synthetic``."""

    subject: SubjectSettings
    light: LightSettings
    pose: PoseSettings
    render: RenderSettings
