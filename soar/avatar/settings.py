"""Settings of the avatar (``conf/avatar``)."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class FieldSettings:
    """Size of the attribute field and how it starts.

    Attributes:
        levels, features: of the hash grid.
        table_log2: entries per level, as a power of two.
        coarsest, finest: cells along the box's side of the first and the last level.
        hidden: width of the two hidden layers of each network.
        scale_max: largest radius, metres.
        margin: side of the box over that of the canonical avatar.
        residual: the networks' outputs are added, in logit space, to each surfel's start instead of to zero.
        prefit_steps, prefit_rate: Adam steps and rate of the fit to the start; not needed where ``residual``.
        chunk: surfels that pass the networks together.
    """

    levels: int
    features: int
    table_log2: int
    coarsest: int
    finest: int
    hidden: int
    scale_max: float
    margin: float
    residual: bool
    prefit_steps: int
    prefit_rate: float
    chunk: int


@dataclasses.dataclass(frozen=True)
class AvatarSettings:
    """How the first avatar is made from the body, and what its attributes are.

    Attributes:
        subdivisions: of the body mesh; each quadruples the faces.
        longest_edge: metres; a longer edge of the subdivided mesh gets a surfel in its middle.
        scale_neighbours: a surfel's radius is the mean distance to so many nearest ones.
        neighbours: body vertices whose skinning weights a surfel blends.
        attributes: ``field``: colour and radius come from Phi; ``explicit``: they are free values of each surfel.
        field: of Phi; unused where explicit.
    """

    subdivisions: int
    longest_edge: float
    scale_neighbours: int
    neighbours: int
    attributes: Literal["field", "explicit"]
    field: FieldSettings
