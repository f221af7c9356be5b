"""ImageDream behind the protocol of priors: prompts, guidance, and the estimate of clean views."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import torch
from torch import Generator, Tensor
from torch.nn import functional as F

from soar.devices import resolve_device
from soar.errors import ConfigError, InputError, NumericalError
from soar.priors.imagedream import schedule
from soar.priors.imagedream.cameras import embedding
from soar.priors.imagedream.checkpoint import Checkpoint
from soar.priors.imagedream.networks import Networks, TorchNetworks
from soar.priors.imagedream.tokens import pixel_values, token_ids, tokenizer
from soar.priors.protocol import VIEWS, Condition, Domain, Views

if TYPE_CHECKING:
    from tokenizers import Tokenizer

SIZE = 256
"""Side of its pictures, pixels."""

SCALE = 0.18215
"""Latents are the autoencoder's, times this."""

FRAMES = {"local": VIEWS, "pixel": VIEWS + 1}
"""Pictures of an object by mode."""

VOCABULARY = "clip_vocabulary.txt.gz"
"""File in the models folder."""

_LOG_VARIANCE = (-30.0, 20.0)  # limits of the autoencoder's logarithm of the variance


@dataclasses.dataclass(frozen=True)
class ImageDreamSettings:
    """Nodes of the providers ``imagedream`` and ``onnx``.

    Attributes:
        provider: ``imagedream`` reads a checkpoint, ``onnx`` a folder that was exported from one.
        source: path of either.
        mode: ``pixel`` shows the image prompt to the U-Net as a fifth view; ``local`` only as tokens of the CLIP tower.
        form: space that distils: ``latent``, through the autoencoder's gradient, or ``image``.
        guidance: scale of classifier-free guidance (Ho and Salimans, 2022).
        rescale: share in [0, 1] of :func:`soar.priors.imagedream.schedule.rescaled`.
        background: grey level in [0, 1] behind views and image prompt.
        negative: what the unconditional estimate is told instead of the text.
        device: ``cpu``, ``cuda``, or ``auto`` = an accelerator where there is one; ``onnx`` runs on the processor.
    """

    provider: Literal["imagedream", "onnx"]
    source: str
    mode: Literal["pixel", "local"]
    form: Literal["latent", "image"]
    guidance: float
    rescale: float
    background: float
    negative: str
    device: str


@dataclasses.dataclass(frozen=True)
class Prompt:
    """An encoded condition, on the processor.

    Attributes:
        domain: of its pictures.
        text: (2, 77, 1024) prompt and negative prompt.
        features: (257, 1280) of the image prompt.
        latent: (4, 32, 32) of the image prompt, without noise; None in the local mode.
    """

    domain: Domain
    text: Tensor
    features: Tensor
    latent: Tensor | None


class ImageDream:
    """The provider; see :class:`soar.priors.protocol.MultiViewPrior`.

    Args:
        options: settings.
        networks: of a checkpoint or an export.
        tokens: splits texts.
        where: device of ``networks``.
        size: side of its pictures; another one than 256 only in tests.
    """

    def __init__(
        self, options: ImageDreamSettings, networks: Networks, tokens: Tokenizer, where: torch.device, size: int = SIZE
    ) -> None:
        self.options, self.networks, self.tokens, self.device, self.size = options, networks, tokens, where, size
        if networks.frames != FRAMES[options.mode]:
            found = next(mode for mode, frames in FRAMES.items() if frames == networks.frames)
            raise ConfigError("the prior's networks are of another mode", expected=options.mode, got=found)

    def prepare(self, conditions: Sequence[Condition]) -> list[Prompt]:
        """See the protocol. Towers are read one after the other, so that only one is in memory."""
        shown = [self._shown(c.domain, c.picture[None], c.alpha[None])[0] for c in conditions]
        texts = list(dict.fromkeys(c.text for c in conditions))
        said = self.networks.text(token_ids(self.tokens, [*texts, self.options.negative])).cpu()
        seen = self.networks.image(pixel_values(torch.stack(shown))).cpu()
        latents: list[Tensor | None] = [None] * len(conditions)
        if self.networks.frames > VIEWS:
            with torch.no_grad():
                latents = [self._latent(picture[None], None)[0].cpu() for picture in shown]
        return [
            Prompt(c.domain, torch.stack([said[texts.index(c.text)], said[-1]]), features, latent)
            for c, features, latent in zip(conditions, seen, latents, strict=True)
        ]

    def estimate(self, prompt: Prompt, views: Views, time: float, generator: Generator) -> Tensor:
        """See the protocol."""
        with torch.no_grad():
            latent = self._latent(self._shown(prompt.domain, views.pictures, views.alpha), generator)
            picture = self._decoded(self.clean(prompt, latent, views, schedule.step_at(time), generator))
        if prompt.domain == "normal":
            picture = torch.cat([picture[:, :1], 1 - picture[:, 1:]], 1)
        return picture.to(views.pictures.device)

    def loss(self, prompt: Prompt, views: Views, time: float, generator: Generator) -> Tensor:
        """See the protocol."""
        shown, step = self._shown(prompt.domain, views.pictures, views.alpha), schedule.step_at(time)
        if self.options.form == "latent":
            latent = self._latent(shown, generator)
            difference = latent - self.clean(prompt, latent.detach(), views, step, generator)
        else:
            with torch.no_grad():
                target = self._decoded(self.clean(prompt, self._latent(shown, generator), views, step, generator))
            difference = 2 * (shown - target)
        return 0.5 * difference.square().sum().to(views.pictures.device) / VIEWS

    @torch.no_grad()
    def clean(self, prompt: Prompt, latent: Tensor, views: Views, step: int, generator: Generator) -> Tensor:
        """(4, 4, 32, 32) estimate of the clean latents of views from their latents, which are noised first.

        Raises:
            NumericalError: the network gave NaN or infinity.
        """
        alpha, sigma = schedule.levels(step)
        noisy = alpha * latent + sigma * _normal(latent, generator)
        conditional, unconditional = self.noise(prompt, noisy, views, step)
        guided = unconditional + self.options.guidance * (conditional - unconditional)
        estimates = (schedule.clean(noisy, noise, step) for noise in (guided, conditional))
        return schedule.rescaled(*estimates, self.options.rescale)

    def noise(self, prompt: Prompt, noisy: Tensor, views: Views, step: int) -> tuple[Tensor, Tensor]:
        """Noise in noisy latents (4, 4, 32, 32), with the prompt and without, in one run of the U-Net."""
        frames = self.networks.frames
        camera = embedding(views.azimuth.float(), views.elevation.float()).to(self.device)
        features = prompt.features.to(self.device)
        # The place of the image prompt: its latent is given apart, and no camera sees it.
        x, camera = (F.pad(part, (0, 0) * (part.ndim - 1) + (0, frames - VIEWS)) for part in (noisy, camera))
        answer = self.networks.noise(
            torch.cat([x, x]),
            torch.full((2 * frames,), step, device=self.device),
            prompt.text.to(self.device).repeat_interleave(frames, 0),
            torch.cat([camera, camera]),
            _with_nothing(features).repeat_interleave(frames, 0),
            None if prompt.latent is None else _with_nothing(prompt.latent).to(self.device),
        )
        if not torch.isfinite(answer).all():
            raise NumericalError(
                "the prior imagedream gave NaN or infinity",
                got=f"step {step}, latents between {noisy.min():.3g} and {noisy.max():.3g}",
                cure="choose prior.device=cpu, which computes in single precision, or the provider mini",
            )
        conditional, unconditional = answer.unflatten(0, (2, frames))[:, :VIEWS]
        return conditional, unconditional

    def _shown(self, domain: Domain, pictures: Tensor, alpha: Tensor) -> Tensor:
        """(N, 3, S, S) before the grey background, on the prior's device; normals as renderers paint them, y up and z
        towards the viewer."""
        if pictures.shape[-2:] != (self.size, self.size):
            raise InputError(
                "pictures do not fit the prior imagedream", expected=f"{self.size} pixels", got=str(pictures.shape[-2:])
            )
        if domain == "normal":
            pictures = torch.cat([pictures[:, :1], alpha - pictures[:, 1:]], 1)
        return (pictures + (1 - alpha) * self.options.background).to(self.device)

    def _latent(self, shown: Tensor, generator: Generator | None) -> Tensor:
        """Scaled latents of pictures: drawn from what the encoder says, or its mean without a generator."""
        mean, log_variance = self.networks.encode(2 * shown - 1).chunk(2, 1)
        if generator is None:
            return SCALE * mean
        deviation = torch.exp(0.5 * log_variance.clamp(*_LOG_VARIANCE))
        return SCALE * (mean + deviation * _normal(mean, generator))

    def _decoded(self, latent: Tensor) -> Tensor:
        """Pictures in [0, 1] of scaled latents."""
        return ((self.networks.decode(latent / SCALE) + 1) / 2).clamp(0, 1)


def _normal(like: Tensor, generator: Generator) -> Tensor:
    """Noise that depends on the generator alone, not on the device that it is used on."""
    return torch.randn(like.shape, generator=generator, device=generator.device).to(like)


def _with_nothing(known: Tensor) -> Tensor:
    """(2, ...): what the conditional and the unconditional estimate are told of the image prompt."""
    return torch.stack([known, torch.zeros_like(known)])


def from_checkpoint(options: ImageDreamSettings, models: Path, threads: int) -> ImageDream:
    """The provider ``imagedream``; weights are read when they are needed.

    Args:
        options: settings.
        models: folder of the model files, with the vocabulary.
        threads: ignored; torch has its own setting.

    Raises:
        ModelFileError: checkpoint or vocabulary are missing or not the right ones.
        ConfigError: no such device, or optional packages are not installed.
    """
    where = resolve_device(options.device, "prior.device")
    networks = TorchNetworks(Checkpoint(Path(options.source)), FRAMES[options.mode], where)
    return ImageDream(options, networks, tokenizer(models / VOCABULARY), where)
