"""Building blocks of a small U-Net that runs at any size its strides divide."""

from __future__ import annotations

import itertools
from typing import TypeVar

import torch
from torch import Tensor, nn

Layer = TypeVar("Layer", nn.Conv2d, nn.Linear)

GROUP = 8
"""Channels that share one mean and variance; widths are multiples of it."""


class ResidualBlock(nn.Module):
    """``x + conv(silu(norm(conv(silu(norm(x))))))``, which starts as the identity.

    The sum is zero at first because the last convolution is, so that depth never hinders the start of training.

    Args:
        channels: in and out; a multiple of 8.
        embedding: length of a vector per picture that scales and shifts the second norm's channels; 0 for none.
    """

    def __init__(self, channels: int, embedding: int = 0) -> None:
        super().__init__()
        self.norm1 = norm(channels)
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.norm2 = norm(channels)
        self.conv2 = zeroed(nn.Conv2d(channels, channels, 3, padding=1))
        self.modulate = zeroed(nn.Linear(embedding, 2 * channels)) if embedding else None

    def forward(self, x: Tensor, embedding: Tensor | None = None) -> Tensor:
        """(N, C, H, W), and (N, E) if there is an embedding, to (N, C, H, W)."""
        inner = self.norm2(self.conv1(nn.functional.silu(self.norm1(x))))
        if self.modulate is not None:
            scale, shift = self.modulate(embedding)[:, :, None, None].chunk(2, 1)
            inner = inner * (1 + scale) + shift
        return x + self.conv2(nn.functional.silu(inner))


class Down(nn.Sequential):
    """(N, C, H, W) to (N, C', H/2, W/2): pixels of a 2 x 2 square become channels, which are mixed."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(nn.PixelUnshuffle(2), nn.Conv2d(4 * channels, out, 1))


class Up(nn.Sequential):
    """(N, C, H, W) to (N, C', 2H, 2W): channels are mixed and become the pixels of a 2 x 2 square."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__(nn.Conv2d(channels, 4 * out, 1), nn.PixelShuffle(2))


class UNet(nn.Module):
    """Encoder, decoder and skip connections; the first resolution is half of the input's.

    Args:
        inputs: channels in.
        outputs: channels out; zero before training.
        widths: channels at 1/2, 1/4, ... of the input's resolution; multiples of 8.
        depths: residual blocks at each of them, on the way down and again on the way up (once at the last).

    Raises:
        ValueError: ``widths`` and ``depths`` differ in length, or a width is no multiple of 8.
    """

    def __init__(self, inputs: int, outputs: int, widths: tuple[int, ...], depths: tuple[int, ...]) -> None:
        super().__init__()
        if len(widths) != len(depths) or any(width % GROUP for width in widths):
            raise ValueError(f"a U-Net cannot have widths {widths} and depths {depths}")
        self.stride = 2 ** len(widths)
        self.enter = enter(inputs, widths[0])
        above = list(itertools.pairwise(widths))
        self.encoders = nn.ModuleList([blocks(width, depth) for width, depth in zip(widths, depths, strict=True)])
        self.downs = nn.ModuleList([Down(wide, narrow) for wide, narrow in above])
        self.ups = nn.ModuleList([Up(narrow, wide) for wide, narrow in above])
        self.joins = nn.ModuleList([nn.Conv2d(2 * width, width, 1) for width in widths[:-1]])
        self.decoders = nn.ModuleList([blocks(width, depth) for width, depth in zip(widths[:-1], depths, strict=False)])
        self.leave = leave(widths[0], outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(N, inputs, H, W) to (N, outputs, H, W); H and W are multiples of ``stride``."""
        x = self.encoders[0](self.enter(x))
        skips = []
        for down, encoder in zip(self.downs, self.encoders[1:], strict=True):
            skips.append(x)
            x = encoder(down(x))
        for up, join, decoder in zip(self.ups[::-1], self.joins[::-1], self.decoders[::-1], strict=True):
            x = decoder(join(torch.cat([up(x), skips.pop()], 1)))
        return self.leave(x)


def enter(inputs: int, channels: int) -> nn.Sequential:
    """(N, inputs, H, W) to (N, C, H/2, W/2)."""
    return nn.Sequential(nn.PixelUnshuffle(2), nn.Conv2d(4 * inputs, channels, 3, padding=1))


def leave(channels: int, outputs: int) -> nn.Sequential:
    """(N, C, H, W) to (N, outputs, 2H, 2W), zero before training."""
    last = zeroed(nn.Conv2d(channels, 4 * outputs, 3, padding=1))
    return nn.Sequential(norm(channels), nn.SiLU(), last, nn.PixelShuffle(2))


def norm(channels: int) -> nn.GroupNorm:
    """Normalisation of groups of 8 channels."""
    return nn.GroupNorm(channels // GROUP, channels)


def blocks(channels: int, count: int) -> nn.Sequential:
    """``count`` residual blocks in a row."""
    return nn.Sequential(*[ResidualBlock(channels) for _ in range(count)])


def zeroed(layer: Layer) -> Layer:
    """The layer with weight and bias set to zero."""
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer
