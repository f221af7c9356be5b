"""Image tokens: a perceiver (Jaegle et al., 2021) from the 257 features of the image encoder to a few tokens."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from soar.priors.imagedream.layers import attend


class Resampler(nn.Module):
    """Learned latents that look at the image; attribute names are the keys of the released checkpoint.

    Args:
        features: length of an image feature.
        width: length of a token.
        tokens: how many.
        depth: layers.
        heads, head: of an attention; ``head`` channels each.
    """

    def __init__(self, features: int, width: int, tokens: int, depth: int, heads: int, head: int) -> None:
        super().__init__()
        self.latents = nn.Parameter(torch.empty(1, tokens, width))
        self.proj_in = nn.Linear(features, width)
        self.proj_out = nn.Linear(width, width)
        self.norm_out = nn.LayerNorm(width)
        self.layers = nn.ModuleList(
            [nn.ModuleList([PerceiverAttention(width, heads, head), feed_forward(width)]) for _ in range(depth)]
        )

    def forward(self, features: Tensor) -> Tensor:
        """(N, 257, F) features to (N, T, D) tokens."""
        x = self.proj_in(features)
        latents = self.latents.expand(x.shape[0], -1, -1)
        for attention, forward in self.layers:
            latents = latents + attention(x, latents)
            latents = latents + forward(latents)
        return self.norm_out(self.proj_out(latents))


class PerceiverAttention(nn.Module):
    """Attention of the latents to the features and to themselves."""

    def __init__(self, width: int, heads: int, head: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.to_q = nn.Linear(width, heads * head, bias=False)
        self.to_kv = nn.Linear(width, 2 * heads * head, bias=False)
        self.to_out = nn.Linear(heads * head, width, bias=False)

    def forward(self, x: Tensor, latents: Tensor) -> Tensor:
        """(N, 257, D) features, (N, T, D) latents to (N, T, D)."""
        latents = self.norm2(latents)
        key, value = self.to_kv(torch.cat([self.norm1(x), latents], 1)).chunk(2, -1)
        return self.to_out(attend(self.to_q(latents), key, value, self.heads))


def feed_forward(width: int) -> nn.Sequential:
    """Normalisation and two linear layers with a GELU between them, without bias."""
    return nn.Sequential(
        nn.LayerNorm(width), nn.Linear(width, 4 * width, bias=False), nn.GELU(), nn.Linear(4 * width, width, bias=False)
    )
