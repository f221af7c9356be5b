"""The denoising U-Net of ImageDream: Stable Diffusion 2.1's, whose self-attention spans the views of an object, with an
embedding of the camera and tokens of an image prompt (Wang and Shi, 2023; Shi et al., MVDream, 2023)."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from soar.priors.imagedream.layers import (
    GROUPS,
    Block,
    Convolution,
    Downsample,
    Residual,
    SpatialTransformer,
    Upsample,
    mlp,
    waves,
)
from soar.priors.imagedream.resampler import Resampler

CAMERA = 16
"""Numbers that tell a camera."""

FEATURES = 1280
"""Length of a feature of the image encoder."""

_TOKEN_LAYERS, _TOKEN_HEADS, _TOKEN_HEAD = 4, 12, 64


@dataclasses.dataclass(frozen=True)
class UNetShape:
    """Size of the network. It is given by the checkpoint; smaller ones serve tests.

    Attributes:
        latent: channels in and out.
        width: channels at the full resolution.
        multiples: channels at 1, 1/2, 1/4, ... of it, as multiples of ``width``.
        depth: residual blocks at each resolution on the way down; one more on the way up.
        attention: resolutions with attention, counted from the full one.
        head: channels of an attention head.
        context: length of a token of text or image.
        tokens: of the image.
    """

    latent: int
    width: int
    multiples: tuple[int, ...]
    depth: int
    attention: int
    head: int
    context: int
    tokens: int


RELEASED = UNetShape(
    latent=4, width=320, multiples=(1, 2, 4, 4), depth=2, attention=3, head=64, context=1024, tokens=16
)
"""Both released checkpoints."""


class UNet(nn.Module):
    """Noise in the latents of all views of an object; attribute names are the keys of the released checkpoint.

    Args:
        shape: see :class:`UNetShape`.
        frames: pictures of an object: 4 views, and in the pixel mode a fifth, the image prompt.
    """

    def __init__(self, shape: UNetShape, frames: int) -> None:
        super().__init__()
        self.width, self.frames = shape.width, frames
        embedding = 4 * shape.width
        widths = [shape.width * multiple for multiple in shape.multiples]

        def layers(channels: int, out: int, level: int) -> list[nn.Module]:
            made: list[nn.Module] = [Residual(channels, out, embedding)]
            if level < shape.attention:
                made.append(SpatialTransformer(out, shape.head, shape.context, frames))
            return made

        self.time_embed = mlp(shape.width, embedding)
        self.camera_embed = mlp(CAMERA, embedding)
        self.image_embed = Resampler(FEATURES, shape.context, shape.tokens, _TOKEN_LAYERS, _TOKEN_HEADS, _TOKEN_HEAD)
        self.input_blocks = nn.ModuleList([Block([Convolution(shape.latent, shape.width, 3, padding=1)])])
        skips, channels = [shape.width], shape.width
        for level, width in enumerate(widths):
            for _ in range(shape.depth):
                self.input_blocks.append(Block(layers(channels, width, level)))
                channels = width
                skips.append(channels)
            if level + 1 < len(widths):
                self.input_blocks.append(Block([Downsample(channels)]))
                skips.append(channels)
        self.middle_block = Block([*layers(channels, channels, 0), Residual(channels, channels, embedding)])
        self.output_blocks = nn.ModuleList()
        for level, width in reversed(list(enumerate(widths))):
            for number in range(shape.depth + 1):
                made = layers(channels + skips.pop(), width, level)
                channels = width
                if level and number == shape.depth:
                    made.append(Upsample(channels))
                self.output_blocks.append(Block(made))
        self.out = nn.Sequential(
            nn.GroupNorm(GROUPS, channels), nn.SiLU(), nn.Conv2d(channels, shape.latent, 3, padding=1)
        )

    def forward(
        self, x: Tensor, timesteps: Tensor, context: Tensor, camera: Tensor, ip: Tensor, ip_img: Tensor | None = None
    ) -> Tensor:
        """Names are those of the ONNX contract (docs/priors.md). N = objects * frames, frames of an object in a row.

        Args:
            x: (N, 4, h, w) noisy latents; h and w are multiples of 8.
            timesteps: (N,) of the 1000 levels of noise.
            context: (N, 77, D) text.
            camera: (N, 16), :func:`soar.priors.imagedream.cameras.embedding`.
            ip: (N, 257, 1280) features of the image prompt; zeros for none.
            ip_img: (objects, 4, h, w) latent of the image prompt, which takes the place of every object's last frame.

        Returns:
            (N, 4, h, w) the noise; of the last frame, where ``ip_img`` is given, it means nothing.
        """
        if ip_img is not None:
            views = x.unflatten(0, (-1, self.frames))
            x = torch.cat([views[:, :-1], ip_img[:, None].to(x.dtype)], 1).flatten(0, 1)
        embedding = self.time_embed(waves(timesteps, self.width).to(x.dtype)) + self.camera_embed(camera)
        tokens = self.image_embed(ip)
        skips = []
        for block in self.input_blocks:
            x = block(x, embedding, context, tokens)
            skips.append(x)
        x = self.middle_block(x, embedding, context, tokens)
        for block in self.output_blocks:
            x = block(torch.cat([x, skips.pop()], 1), embedding, context, tokens)
        return self.out(x)
