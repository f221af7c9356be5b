"""The multi-view prior: a small diffusion model of four views of one person, given one picture of them.

The interface follows ImageDream (Wang and Shi, 2023): four views 90 degrees apart, denoised together, attending to
each other and to a clean condition picture. What it sees besides is what a renderer of the posed body knows of every
view, so that it learns where on the body a pixel is, and to carry there what the picture shows.
"""

from __future__ import annotations

import dataclasses
import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from soar.errors import ConfigError
from soar.networks.blocks import GROUP, Down, ResidualBlock, Up, leave, norm, zeroed
from soar.networks.diffusion import levels
from soar.networks.prior_inputs import ALPHA_KNOWN, BODY, CARRIED, CONDITIONED, DOMAIN, PLACE, RULES, VIEWS

_FREQUENCIES = (math.pi, 2 * math.pi, 4 * math.pi)  # of the waves that canonical coordinates are told in
_TIMES = 16  # waves that the time is told in
_WAVES = 6 * len(_FREQUENCIES)
_POSITION = 3 + _WAVES
_GIVEN = 3 + 7 + 2 + CARRIED + 1  # noisy, geometry, alpha and whether it is known, carried, role
_COPIES = RULES + 1  # candidates copied from the picture: by rule, and by attention
_LIGHT = 1.5  # largest logarithm of what a copy's brightness is multiplied by
_LEAST = 0.05  # coverage of a place in the picture whose colour can be looked up
_NEVER = -1e4  # logit of what must not be chosen


@dataclasses.dataclass(frozen=True)
class PriorNetworkSettings:
    """Size of the network.

    Attributes:
        widths: channels at 1/2, 1/4 and 1/8 of the picture's resolution, multiples of 8; the last two of ``head``.
        depths: residual blocks at each, on the way down and again on the way up.
        embedding: length of the vector that tells time and flags.
        head: channels of an attention head.
        pointer: length of the features that colours are looked up by.
    """

    widths: tuple[int, int, int]
    depths: tuple[int, int, int]
    embedding: int
    head: int
    pointer: int

    def __post_init__(self) -> None:
        if any(width % GROUP for width in self.widths) or any(width % self.head for width in self.widths[1:]):
            raise ConfigError(
                "a prior of these widths cannot be built",
                expected=f"multiples of {GROUP}, the last two of head ({self.head}) too",
                got=str(self.widths),
            )


class PriorNetwork(nn.Module):
    """Four clean views from four noisy ones.

    A U-Net over the views and the condition picture, with attention to the picture at 1/4 of the resolution and among
    all five at 1/8. Its output is a *copy head*: every pixel is a mixture of the carried colours, of colours looked up
    in the picture by attention, both made brighter or darker, of the background and of a painted colour. Only the
    painted one sees the noisy view directly: it is ``alpha x_t - sigma v``, which hands little noise through unchanged.
    """

    def __init__(self, settings: PriorNetworkSettings) -> None:
        super().__init__()
        (fine, middle, coarse), depths, embedding = settings.widths, settings.depths, settings.embedding
        self.pointer = settings.pointer
        self.embed = nn.Sequential(
            nn.Linear(2 * _TIMES + 3, embedding), nn.SiLU(), nn.Linear(embedding, embedding), nn.SiLU()
        )
        self.enter = nn.Conv2d(4 * _GIVEN + _WAVES, fine, 3, padding=1)
        self.down_fine = _Blocks(fine, depths[0], embedding)
        self.to_middle = Down(fine, middle)
        self.down_middle = _Blocks(middle, depths[1], embedding)
        self.look = ViewAttention(middle, settings.head, everyone=False)
        self.to_coarse = Down(middle, coarse)
        self.down_coarse = _Blocks(coarse, depths[2], embedding)
        self.exchange = ViewAttention(coarse, settings.head, everyone=True)
        self.up_coarse = _Blocks(coarse, depths[2], embedding)
        self.from_coarse = Up(coarse, middle)
        self.join_middle = nn.Conv2d(2 * middle, middle, 1)
        self.up_middle = _Blocks(middle, depths[1], embedding)
        self.from_middle = Up(middle, fine)
        self.join_fine = nn.Conv2d(2 * fine, fine, 1)
        self.up_fine = _Blocks(fine, depths[0] + 1, embedding)
        self.query = nn.Conv2d(fine, settings.pointer, 1)
        self.key = nn.Conv2d(middle, settings.pointer, 1)
        # Logits of the copies, paint and background; the velocity; the logarithm of the copies' brightness.
        self.leave = leave(fine, _COPIES + 2 + 3 + 1)

    def forward(
        self,
        noisy: Tensor,
        time: Tensor,
        image: Tensor,
        geometry: Tensor,
        alpha: Tensor,
        carried: Tensor,
        flags: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Tensors as :func:`soar.networks.prior_inputs.signature` names them; H and W are multiples of 8.

        Args:
            noisy: (N, 4, 3, H, W) views with noise.
            time: (N,) how much, :mod:`soar.networks.diffusion`.
            image: (N, 3, H, W) the condition picture.
            geometry: (N, 5, 7, H, W) of the views and, last, of the picture.
            alpha: (N, 5, 1, H, W) coverage: of the views, by the person if it is known, else by the body; of the
                picture.
            carried: (N, 4, 13, H, W) :func:`~soar.networks.prior_inputs.carried` colours.
            flags: (N, 3) domain, conditioned, alpha known.

        Returns:
            clean (N, 4, 3, H, W), in [-1, 1] unless painted beyond, and its coverage (N, 4, 1, H, W) in [0, 1].
        """
        views, (height, width) = VIEWS + 1, image.shape[-2:]
        # What is carried to normal maps is the body's, not the picture's: only colours are hidden with it.
        keep = flags[:, CONDITIONED, None, None, None]
        travels = torch.maximum(keep, flags[:, DOMAIN, None, None, None])
        image, alpha_picture, carried = image * keep, alpha[:, VIEWS] * keep, carried * travels[:, None]
        embedding = self.embed(torch.cat([_waves(time), flags], 1)).repeat_interleave(views, 0)
        position = _position(geometry)
        at_half = F.avg_pool2d(position, 2)
        at_quarter = F.avg_pool2d(at_half, 2)
        at_eighth = F.avg_pool2d(at_quarter, 2)

        planes = self._planes(noisy, image, geometry, alpha[:, :VIEWS], alpha_picture, carried, flags)
        x = self.enter(torch.cat([F.pixel_unshuffle(planes, 2), at_half[:, 3:]], 1))
        fine = self.down_fine(x, embedding)
        middle = self.down_middle(self.to_middle(fine), embedding)
        middle = self.look(middle, at_quarter)
        coarse = self.down_coarse(self.to_coarse(middle), embedding)
        coarse = self.exchange(coarse, at_eighth)
        coarse = self.up_coarse(coarse, embedding)
        middle = self.up_middle(self.join_middle(torch.cat([self.from_coarse(coarse), middle], 1)), embedding)

        # From here on the picture itself has no part.
        picture, middle, fine, embedding = _last(middle), *(_first(value) for value in (middle, fine, embedding))
        fine = self.up_fine(self.join_fine(torch.cat([self.from_middle(middle), fine], 1)), embedding)
        looked_up = self._look_up(fine, picture, image, alpha_picture)
        head = self.leave(fine).unflatten(0, (-1, VIEWS))
        weights, velocity = self._weights(head, keep, travels), head[:, :, _COPIES + 2 : -1]
        level, noise = levels(time)
        painted = level * noisy - noise * velocity
        copies = carried[:, :, : 3 * RULES].reshape(-1, VIEWS, RULES, 3, height, width)
        copies = torch.cat([copies, looked_up[:, :, None]], 2)
        # The other side is lit otherwise: colours, which span -1 to 1, are multiplied from black on. Normals stay.
        light = head[:, :, -1:, None].clamp(-_LIGHT, _LIGHT) * (1 - flags[:, DOMAIN, None, None, None, None, None])
        copies = (copies + 1) * light.exp() - 1
        choice = torch.cat([copies, painted[:, :, None]], 2)  # the background is 0
        clean = (weights[:, :, : _COPIES + 1, None] * choice).sum(2)
        return clean, 1 - weights[:, :, _COPIES + 1 :]

    @staticmethod
    def _planes(
        noisy: Tensor,
        image: Tensor,
        geometry: Tensor,
        alpha: Tensor,
        alpha_picture: Tensor,
        carried: Tensor,
        flags: Tensor,
    ) -> Tensor:
        """(N * 5, planes, H, W): all that is given of every view; the picture is a view without noise."""
        known = flags[:, ALPHA_KNOWN, None, None, None, None].expand_as(alpha)
        one, nothing = torch.ones_like(alpha[:, :1]), torch.zeros_like(carried[:, :1])
        views = [noisy, geometry[:, :VIEWS], alpha, known, carried, torch.zeros_like(alpha)]
        picture = [image[:, None], geometry[:, VIEWS:], alpha_picture[:, None], one, nothing, one]
        return torch.cat([torch.cat(views, 2), torch.cat(picture, 2)], 1).flatten(0, 1)

    def _look_up(self, fine: Tensor, picture: Tensor, image: Tensor, alpha: Tensor) -> Tensor:
        """(N, 4, 3, H, W) colours of the picture by attention: queries at 1/2, keys and mean colours at 1/4."""
        query = self.query(fine).unflatten(0, (-1, VIEWS)).permute(0, 1, 3, 4, 2).flatten(1, 3)
        key = self.key(picture).flatten(2)
        colours = F.avg_pool2d(torch.cat([image, alpha], 1), 4).flatten(2)
        colour, share = colours[:, :3], colours[:, 3:]
        empty = _NEVER * (share < _LEAST).to(share.dtype)
        weights = torch.softmax(query @ key / math.sqrt(self.pointer) + empty, -1)
        looked = weights @ (colour / share.clamp_min(_LEAST)).transpose(1, 2)
        rows = looked.reshape(-1, fine.shape[-2], fine.shape[-1], 3).permute(0, 3, 1, 2)
        return F.interpolate(rows, scale_factor=2.0, mode="nearest").unflatten(0, (-1, VIEWS))

    @staticmethod
    def _weights(head: Tensor, keep: Tensor, travels: Tensor) -> Tensor:
        """(N, 4, 7, H, W) shares of the copies, of what is painted, and of the background."""
        by_rule, looked_up = (
            head.new_tensor([float(k in which) for k in range(_COPIES + 2)])[:, None, None]
            for which in (range(RULES), range(RULES, _COPIES))
        )
        hidden = by_rule * (1 - travels[:, None]) + looked_up * (1 - keep[:, None])
        return torch.softmax(head[:, :, : _COPIES + 2] + _NEVER * hidden, 2)


class ViewAttention(nn.Module):
    """Attention between the five views of a person; queries and keys know where on the body they are.

    Args:
        channels: of the features.
        head: channels of a head.
        everyone: every view attends to all five; else to the condition picture only.
    """

    def __init__(self, channels: int, head: int, everyone: bool) -> None:
        super().__init__()
        self.heads, self.everyone = channels // head, everyone
        self.norm = norm(channels)
        self.value = nn.Conv2d(channels, channels, 1)
        self.pair = nn.Conv2d(channels + _POSITION, 2 * channels, 1)
        self.leave = zeroed(nn.Conv2d(channels, channels, 1))

    def forward(self, x: Tensor, position: Tensor) -> Tensor:
        """(N * 5, C, h, w) features and (N * 5, 21, h, w) positions to features."""
        height, width = x.shape[-2:]
        inner = self.norm(x)
        query, key = self.pair(torch.cat([inner, position], 1)).chunk(2, 1)
        value = self.value(inner)
        if not self.everyone:
            key, value = (_last(tokens)[:, None] for tokens in (key, value))
        query, key, value = (self._tokens(tokens) for tokens in (query, key, value))
        mixed = torch.softmax(query @ key.transpose(-1, -2) / math.sqrt(query.shape[-1]), -1) @ value
        mixed = mixed.transpose(1, 2).reshape(-1, height, width, x.shape[1]).permute(0, 3, 1, 2)
        return x + self.leave(mixed)

    def _tokens(self, x: Tensor) -> Tensor:
        """(N * 5, C, h, w), or (N, 1, C, h, w), to (N, heads, tokens, channels of a head)."""
        views = x if x.ndim == 5 else x.unflatten(0, (-1, VIEWS + 1))
        return views.unflatten(2, (self.heads, -1)).permute(0, 2, 1, 4, 5, 3).flatten(2, 4)


class _Blocks(nn.Module):
    """Residual blocks in a row that all receive the embedding."""

    def __init__(self, channels: int, count: int, embedding: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([ResidualBlock(channels, embedding) for _ in range(count)])

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        for block in self.blocks:
            x = block(x, embedding)
        return x


def _first(x: Tensor) -> Tensor:
    """The four views of (N * 5, ...) as (N * 4, ...)."""
    return x.unflatten(0, (-1, VIEWS + 1))[:, :VIEWS].flatten(0, 1)


def _last(x: Tensor) -> Tensor:
    """The picture of (N * 5, ...) as (N, ...)."""
    return x.unflatten(0, (-1, VIEWS + 1))[:, VIEWS]


def _waves(time: Tensor) -> Tensor:
    """(N, 32) of times (N,) in [0, 1]."""
    angles = time[:, None] * torch.exp2(torch.linspace(-1, 6, _TIMES, device=time.device)) * math.pi
    return torch.cat([angles.sin(), angles.cos()], 1)


def _position(geometry: Tensor) -> Tensor:
    """(N * 5, 21, H, W): canonical coordinates and waves of them, zero where no body is."""
    place, body = geometry[:, :, PLACE].flatten(0, 1), geometry[:, :, BODY].flatten(0, 1)
    waves = [f(k * place) for k in _FREQUENCIES for f in (torch.sin, torch.cos)]
    return torch.cat([place, *waves], 1) * body
