"""The attribute field Phi: a multi-resolution hash grid and two small networks give colour and radius at a point."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from soar.avatar.settings import FieldSettings
from soar.avatar.surfels import SCALE_RANGE
from soar.raster import hash_encode


class Field(nn.Module):
    """Phi: canonical position -> colour in [0, 1] and radius in (0, scale_max) metres (paper, section 3.1).

    Args:
        points: (N, 3) where the field will be asked; sets the box it covers, and the base of the residual form.
        colours: (N, 3) start colours.
        scales: (N,) start radii, metres.
        settings: sizes; ``residual`` adds the networks' outputs (in logit space) to the start instead of to zero.
        generator: draws the initial weights.
    """

    lower: Tensor
    size: Tensor
    base: Tensor
    resolutions: Tensor

    def __init__(
        self, points: Tensor, colours: Tensor, scales: Tensor, settings: FieldSettings, generator: torch.Generator
    ):
        super().__init__()
        self.settings = settings
        low, high = points.min(0).values, points.max(0).values
        size = (high - low).max() * settings.margin
        self.register_buffer("lower", (low + high) / 2 - size / 2)
        self.register_buffer("size", size)
        base = torch.cat([_logit(colours), _logit(scales / settings.scale_max)[:, None]], 1)
        self.register_buffer("base", base if settings.residual else torch.zeros_like(base))
        growth = (settings.finest / settings.coarsest) ** (1 / max(settings.levels - 1, 1))
        self.register_buffer(
            "resolutions", torch.tensor([int(settings.coarsest * growth**k + 1e-6) for k in range(settings.levels)])
        )
        table = torch.empty(settings.levels, 2**settings.table_log2, settings.features)
        self.table = nn.Parameter(table.uniform_(-1e-4, 1e-4, generator=generator))
        width = settings.levels * settings.features
        self.colour = _network((width, settings.hidden, settings.hidden, 3), settings.residual, generator)
        self.scale = _network((width, settings.hidden, settings.hidden, 1), settings.residual, generator)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Colours (N, 3) and radii (N,) at the current ``points`` (N, 3) of the surfels the field was made for."""
        code = hash_encode((points - self.lower) / self.size, self.table, self.resolutions)
        # Activations of small chunks stay in the cache; a whole-body batch is memory bound.
        raw = torch.cat([torch.cat([self.colour(c), self.scale(c)], 1) for c in code.split(self.settings.chunk)])
        value = torch.sigmoid(raw + self.base)
        return value[:, :3], (value[:, 3] * self.settings.scale_max).clamp(*SCALE_RANGE)


def prefit(field: Field, points: Tensor, normals: Tensor, colours: Tensor, scales: Tensor) -> None:
    """Fit the field to start colours and radii on the surface and 1 mm above it, so that neither side is undefined.

    Args:
        field: changed in place; ``settings.prefit_steps`` Adam steps.
        points, normals, colours: (N, 3).
        scales: (N,) metres.
    """
    optimiser = torch.optim.Adam(field.parameters(), lr=field.settings.prefit_rate)
    for step in range(field.settings.prefit_steps):
        optimiser.zero_grad(set_to_none=True)
        colour, scale = field(points + 1e-3 * normals if step % 2 else points)
        loss = (colour - colours).square().mean() + 1000 * (scale - scales).square().mean()
        loss.backward()
        optimiser.step()


def _logit(value: Tensor) -> Tensor:
    return torch.logit(value.clamp(1e-3, 1 - 1e-3))


def _network(widths: tuple[int, ...], zero_last: bool, generator: torch.Generator) -> nn.Sequential:
    layers: list[nn.Module] = []
    for fan_in, fan_out in itertools.pairwise(widths):
        linear = nn.Linear(fan_in, fan_out)
        bound = fan_in**-0.5
        with torch.no_grad():
            linear.weight.uniform_(-bound, bound, generator=generator)
            linear.bias.zero_()
        layers += [linear, nn.ReLU()]
    last = layers[-2]
    if zero_last and isinstance(last, nn.Linear):
        nn.init.zeros_(last.weight)
    return nn.Sequential(*layers[:-1])
