"""Layers of the denoising U-Net; attribute names are the keys of the released checkpoint.

Every layer takes the same four tensors, so that blocks need not know which of their layers looks at what: features
(N, C, H, W), the embedding (N, E) of time and camera, text (N, 77, D) and image tokens (N, T, D). N counts views.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

GROUPS = 32
"""Groups of channels that share mean and variance."""


class Block(nn.ModuleList):
    """Layers in a row."""

    def forward(self, x: Tensor, embedding: Tensor, text: Tensor, image: Tensor) -> Tensor:
        for layer in self:
            x = layer(x, embedding, text, image)
        return x


class Convolution(nn.Conv2d):
    """The 3 x 3 convolution that opens the network."""

    def forward(self, x: Tensor, *_: Tensor) -> Tensor:
        return super().forward(x)


class Downsample(nn.Module):
    """(N, C, H, W) to (N, C, H/2, W/2)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor, *_: Tensor) -> Tensor:
        return self.op(x)


class Upsample(nn.Module):
    """(N, C, H, W) to (N, C, 2H, 2W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor, *_: Tensor) -> Tensor:
        return self.conv(F.interpolate(x, scale_factor=2.0, mode="nearest"))


class Residual(nn.Module):
    """Two convolutions beside a short cut; the embedding is added between them."""

    def __init__(self, channels: int, out: int, embedding: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(
            nn.GroupNorm(GROUPS, channels), nn.SiLU(), nn.Conv2d(channels, out, 3, padding=1)
        )
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding, out))
        # Index 2 is a dropout in the original; here it only keeps the numbers of the keys.
        self.out_layers = nn.Sequential(
            nn.GroupNorm(GROUPS, out), nn.SiLU(), nn.Identity(), nn.Conv2d(out, out, 3, padding=1)
        )
        self.skip_connection = nn.Identity() if channels == out else nn.Conv2d(channels, out, 1)

    def forward(self, x: Tensor, embedding: Tensor, *_: Tensor) -> Tensor:
        inner = self.in_layers(x) + self.emb_layers(embedding)[:, :, None, None]
        return self.skip_connection(x) + self.out_layers(inner)


class SpatialTransformer(nn.Module):
    """Attention of pixels to the pixels of all views of their object, to text, and to the image prompt.

    Args:
        channels: of the features.
        head: channels of an attention head.
        context: length of a token.
        frames: views of an object; consecutive along the batch.
    """

    def __init__(self, channels: int, head: int, context: int, frames: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, channels, eps=1e-6)
        self.proj_in = nn.Linear(channels, channels)
        self.transformer_blocks = nn.ModuleList([TransformerBlock(channels, head, context, frames)])
        self.proj_out = nn.Linear(channels, channels)

    def forward(self, x: Tensor, _: Tensor, text: Tensor, image: Tensor) -> Tensor:
        tokens = self.proj_in(self.norm(x).flatten(2).transpose(1, 2))
        for block in self.transformer_blocks:
            tokens = block(tokens, text, image)
        return x + self.proj_out(tokens).transpose(1, 2).unflatten(2, tuple(x.shape[2:]))


class TransformerBlock(nn.Module):
    """Self-attention across views ("3D"), cross-attention, feed-forward; arguments as :class:`SpatialTransformer`."""

    def __init__(self, channels: int, head: int, context: int, frames: int) -> None:
        super().__init__()
        self.frames = frames
        self.attn1 = Attention(channels, head, channels)
        self.ff = FeedForward(channels)
        self.attn2 = CrossAttention(channels, head, context)
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(channels) for _ in range(3))

    def forward(self, x: Tensor, text: Tensor, image: Tensor) -> Tensor:
        """(N, L, C) pixels, (N, 77, D) text and (N, T, D) image tokens to (N, L, C)."""
        # (objects, frames * L, C): a pixel sees every pixel of every view.
        together = self.norm1(x).unflatten(0, (-1, self.frames)).flatten(1, 2)
        x = x + self.attn1(together, together).unflatten(1, (self.frames, -1)).flatten(0, 1)
        x = x + self.attn2(self.norm2(x), text, image)
        return x + self.ff(self.norm3(x))


class Attention(nn.Module):
    """Multi-head attention of (N, L, C) queries to (N, M, D) tokens."""

    def __init__(self, channels: int, head: int, context: int) -> None:
        super().__init__()
        self.heads = channels // head
        self.to_q = nn.Linear(channels, channels, bias=False)
        self.to_k = nn.Linear(context, channels, bias=False)
        self.to_v = nn.Linear(context, channels, bias=False)
        self.to_out = nn.Sequential(nn.Linear(channels, channels))

    def forward(self, x: Tensor, tokens: Tensor) -> Tensor:
        return self.to_out(attend(self.to_q(x), self.to_k(tokens), self.to_v(tokens), self.heads))


class CrossAttention(Attention):
    """Attention to text and, by keys and values of its own, to the image prompt; both answers are added."""

    def __init__(self, channels: int, head: int, context: int) -> None:
        super().__init__(channels, head, context)
        self.to_k_ip = nn.Linear(context, channels, bias=False)
        self.to_v_ip = nn.Linear(context, channels, bias=False)

    def forward(self, x: Tensor, text: Tensor, image: Tensor) -> Tensor:
        query = self.to_q(x)
        said = attend(query, self.to_k(text), self.to_v(text), self.heads)
        seen = attend(query, self.to_k_ip(image), self.to_v_ip(image), self.heads)
        return self.to_out(said + seen)


class FeedForward(nn.Module):
    """Gated linear unit (GEGLU; Shazeer, 2020) of four times the width."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # Index 1 is a dropout in the original.
        self.net = nn.ModuleList([Gated(channels, 4 * channels), nn.Identity(), nn.Linear(4 * channels, channels)])

    def forward(self, x: Tensor) -> Tensor:
        return self.net[2](self.net[0](x))


class Gated(nn.Module):
    """(..., C) to (..., C'): one half times the GELU of the other."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.proj = nn.Linear(channels, 2 * out)

    def forward(self, x: Tensor) -> Tensor:
        value, gate = self.proj(x).chunk(2, -1)
        return value * F.gelu(gate)


def attend(query: Tensor, key: Tensor, value: Tensor, heads: int) -> Tensor:
    """Scaled dot-product attention of (N, L, heads * c) queries to (N, M, heads * c) keys and values."""
    query, key, value = (x.unflatten(2, (heads, -1)).transpose(1, 2) for x in (query, key, value))
    return F.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)


def waves(steps: Tensor, channels: int) -> Tensor:
    """Cosines, then sines, of ``steps`` (N,) at ``channels / 2`` frequencies from 1 towards 1e-4: (N, channels)."""
    half = channels // 2
    # In this order of operations: step 811 magnifies the rounding of a frequency to 1e-4 of an angle.
    frequencies = torch.exp(-math.log(10000) * torch.arange(half, device=steps.device, dtype=torch.float32) / half)
    angles = steps[:, None].float() * frequencies
    return torch.cat([angles.cos(), angles.sin()], 1)


def mlp(inputs: int, out: int) -> nn.Sequential:
    """Two linear layers with a SiLU between them."""
    return nn.Sequential(nn.Linear(inputs, out), nn.SiLU(), nn.Linear(out, out))
