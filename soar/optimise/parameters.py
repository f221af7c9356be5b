"""What an optimisation moves: the surfels' geometry, and their attributes either free or through the field."""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor, nn

from soar.avatar.articulate import unit
from soar.avatar.field import Field, prefit
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import SCALE_RANGE, Avatar
from soar.errors import ConfigError
from soar.optimise.uniform import UniformAdam


@dataclasses.dataclass(frozen=True)
class Rates:
    """Adam step sizes: metres, radians, colour units, log-radii; ``field`` for grid and networks; 0 holds still."""

    positions: float
    normals: float
    colours: float
    scales: float
    field: float


class Surface(nn.Module):
    """The learnable avatar.

    Args:
        start: the avatar to begin with.
        settings: whether colour and radius come from the field or are free, and the field's size.
        generator: draws the field's initial weights.
    """

    def __init__(self, start: Avatar, settings: AvatarSettings, generator: torch.Generator) -> None:
        super().__init__()
        self.start = start
        self.positions = nn.Parameter(start.positions.clone())
        self.normals = nn.Parameter(start.normals.contiguous())
        self.field: Field | None = None
        if settings.attributes == "field":
            self.field = Field(start.positions, start.colours, start.scales, settings.field, generator)
            prefit(self.field, start.positions, start.normals, start.colours, start.scales)
        else:
            self.colours = nn.Parameter(start.colours.clone())
            self.log_scales = nn.Parameter(start.scales.log())

    def attributes(self) -> tuple[Tensor, Tensor]:
        """Colours (N, 3) and radii (N,); the field is asked at detached positions, so it never moves a surfel."""
        if self.field is not None:
            return self.field(self.positions.detach())
        return self.colours.clamp(0, 1), self.log_scales.clamp(*map(math.log, SCALE_RANGE)).exp()

    def optimisers(self, rates: Rates, shared: bool) -> list[torch.optim.Optimizer]:
        """Adam for normals and attributes, and for the positions either Adam or, ``shared``, :class:`UniformAdam`.

        Each group keeps its first rate as ``initial``. What has rate 0 stays as it is and receives no gradient; scales
        of rate 0 hold a field's too.

        Raises:
            ConfigError: every rate is 0.
        """
        rated = [([self.normals], rates.normals)]
        if self.field is not None:
            scale = list(self.field.scale.parameters())
            held = set(map(id, scale))
            rated.append(([p for p in self.field.parameters() if id(p) not in held], rates.field))
            rated.append((scale, rates.field if rates.scales > 0 else 0.0))
        else:
            rated += [([self.colours], rates.colours), ([self.log_scales], rates.scales)]
        for parameters, rate in ([self.positions], rates.positions), *rated:
            for parameter in parameters:
                parameter.requires_grad_(rate > 0)
        groups = [{"params": p, "lr": r, "initial": r} for p, r in rated if r > 0]
        positions = [{"params": [self.positions], "lr": rates.positions, "initial": rates.positions}]
        optimisers: list[torch.optim.Optimizer] = []
        if rates.positions > 0 and shared:
            optimisers.append(UniformAdam(positions, rates.positions))
        elif rates.positions > 0:
            groups = [*positions, *groups]
        if groups:
            optimisers.append(torch.optim.Adam(groups, eps=1e-15, fused=True))
        if not optimisers:
            raise ConfigError("nothing would move: every rate is 0", cure="raise a rate, or ask for 0 steps")
        return optimisers

    @torch.no_grad()
    def avatar(self) -> Avatar:
        """The avatar as it is now."""
        colours, scales = self.attributes()
        return self.start.replace(
            positions=self.positions.detach().clone(),
            normals=unit(self.normals),
            colours=colours.clone(),
            scales=scales.clone(),
        )


def cosine_decay(step: int, steps: int, final: float) -> float:
    """Factor of the step size at ``step`` of ``steps``: from 1 down to ``final`` along half a cosine."""
    return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * step / max(steps, 1)))
