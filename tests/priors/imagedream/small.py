"""Small networks with weights that are a formula, and a prior made of them, for tests."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from soar.priors.imagedream.prior import FRAMES, ImageDream, ImageDreamSettings
from soar.priors.imagedream.unet import FEATURES, UNet, UNetShape
from soar.priors.protocol import Condition, Views

SHAPE = UNetShape(latent=4, width=32, multiples=(1, 2), depth=1, attention=1, head=16, context=16, tokens=2)
SIZE = 64
OPTIONS = ImageDreamSettings(
    provider="imagedream", source="", mode="pixel", form="latent", guidance=5.0, rescale=0.0, background=0.5,
    negative="ugly", device="cpu",
)  # fmt: skip


def digest(shapes: Mapping[str, Sequence[int]]) -> str:
    """Of all keys and shapes."""
    return hashlib.sha256("\n".join(f"{k} {tuple(v)}" for k, v in sorted(shapes.items())).encode()).hexdigest()


def wave(frequency: float, phase: float, *shape: int) -> Tensor:
    """Sines in place of noise, the same everywhere."""
    return torch.from_numpy(np.sin(frequency * np.arange(int(np.prod(shape))) + phase).reshape(shape)).float()


def weights(shapes: Mapping[str, Sequence[int]]) -> dict[str, Tensor]:
    """Sines in place of weights, each key's of another phase, scaled so that signals neither die nor explode."""
    made = {}
    for number, (key, shape) in enumerate(sorted(shapes.items())):
        sines = np.sin(0.37 * np.arange(int(np.prod(shape))) + 1.7 * number).reshape(tuple(shape))
        if len(shape) == 1:
            sines = 1 + 0.1 * sines if key.endswith("weight") else 0.1 * sines
        else:
            sines = sines * np.sqrt(2 / np.prod(shape[1:]))
        made[key] = torch.from_numpy(np.asarray(sines)).float()
    return made


def filled(module: nn.Module) -> nn.Module:
    """The module with weights by formula."""
    module.load_state_dict(weights({key: value.shape for key, value in module.state_dict().items()}))
    return module.requires_grad_(False).eval()


class SmallAutoencoder(nn.Module):
    """Pictures to moments and latents to pictures; neither is linear."""

    def __init__(self) -> None:
        super().__init__()
        self.inward, self.outward = nn.Conv2d(3, 8, 8, stride=8), nn.Conv2d(4, 3 * 64, 1)

    def encode(self, picture: Tensor) -> Tensor:
        return torch.tanh(self.inward(picture))

    def decode(self, latent: Tensor) -> Tensor:
        return torch.tanh(F.pixel_shuffle(self.outward(latent), 8))


class Words(nn.Module):
    """Token numbers to vectors."""

    def __init__(self) -> None:
        super().__init__()
        self.table = nn.Embedding(1000, SHAPE.context)

    def forward(self, input_ids: Tensor) -> Tensor:
        return self.table(input_ids)


class Look(nn.Module):
    """Pictures (B, 3, 224, 224) to features, of the whole and of 16 x 16 patches."""

    def __init__(self) -> None:
        super().__init__()
        self.project = nn.Linear(3, FEATURES)

    def forward(self, pixel_values: Tensor) -> Tensor:
        patches = F.avg_pool2d(pixel_values, 14).flatten(2)
        return self.project(torch.cat([patches.mean(2, keepdim=True), patches], 2).transpose(1, 2))


class SmallNetworks:
    """:class:`soar.priors.imagedream.networks.Networks`, in double precision unless told otherwise; keeps what it was
    asked."""

    def __init__(self, mode: str = "pixel", dtype: torch.dtype = torch.float64) -> None:
        self.frames, self.dtype = FRAMES[mode], dtype
        self.unet = filled(UNet(SHAPE, self.frames)).to(dtype)
        self.autoencoder, self.words, self.look = (filled(kind()).to(dtype) for kind in (SmallAutoencoder, Words, Look))
        self.asked: list[tuple[str, tuple[Tensor | None, ...]]] = []

    def text_tower(self) -> nn.Module:
        return self.words

    def image_tower(self) -> nn.Module:
        return self.look

    def text(self, input_ids: Tensor) -> Tensor:
        self.asked.append(("text", (input_ids,)))
        return self.words(input_ids)

    def image(self, pixel_values: Tensor) -> Tensor:
        self.asked.append(("image", (pixel_values,)))
        return self.look(pixel_values.to(self.dtype))

    def encode(self, picture: Tensor) -> Tensor:
        return self.autoencoder.encode(picture.to(self.dtype))

    def decode(self, latent: Tensor) -> Tensor:
        return self.autoencoder.decode(latent.to(self.dtype))

    def noise(self, *given: Tensor | None) -> Tensor:
        self.asked.append(("noise", given))
        cast = (x if x is None or not x.is_floating_point() else x.to(self.dtype) for x in given)
        return self.unet(*cast)


class SmallTokens:
    """A word is a token: its length; 1 starts and 2 ends."""

    def encode(self, text: str) -> SimpleNamespace:
        return SimpleNamespace(ids=[1, *(2 + len(word) for word in text.split()), 2])


def prior(options: ImageDreamSettings = OPTIONS, networks: SmallNetworks | None = None) -> ImageDream:
    return ImageDream(options, networks or SmallNetworks(options.mode), SmallTokens(), torch.device("cpu"), SIZE)


def condition(domain: str = "colour", text: str = "a man in red", phase: float = 0.0) -> Condition:
    alpha = 0.5 + 0.5 * wave(0.31, 1 + phase, 1, SIZE, SIZE)
    picture = (0.5 + 0.5 * wave(0.17, phase, 3, SIZE, SIZE)) * alpha
    return Condition(domain, picture, alpha, torch.zeros(7, SIZE, SIZE), text)


def views() -> Views:
    alpha = 0.5 + 0.5 * wave(0.29, 1, 4, 1, SIZE, SIZE).double()
    pictures = ((0.5 + 0.5 * wave(0.13, 2, 4, 3, SIZE, SIZE)).double() * alpha).requires_grad_()
    azimuth = torch.tensor([10.0, 100.0, 190.0, -80.0])
    return Views(pictures, alpha, torch.zeros(4, 7, SIZE, SIZE), azimuth, torch.full((4,), 5.0))


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(7)
