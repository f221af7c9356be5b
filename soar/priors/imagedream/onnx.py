"""The provider ``onnx``: the networks of ImageDream as ONNX files, forward only, so that it distils in image space.

Files and tensors are those of the contract in docs/priors.md; :mod:`soar.priors.imagedream.export` writes them.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import onnxruntime as ort
import torch
from torch import Tensor

from soar.errors import ConfigError
from soar.models.onnx import Signature, session
from soar.priors.imagedream.prior import FRAMES, ImageDream, ImageDreamSettings
from soar.priors.imagedream.tokens import LENGTH, SIDE, tokenizer
from soar.priors.imagedream.unet import CAMERA, FEATURES, RELEASED

TOKENS = "tokenizer.json"
"""File of the folder that splits texts."""

UNET_INPUTS = ("x", "timesteps", "context", "camera", "ip", "ip_img")
"""Inputs of the U-Net; the last in the pixel mode only."""


def signatures(mode: str, latent: int = 32, context: int = RELEASED.context) -> dict[str, Signature]:
    """Names and shapes of the tensors of every file, without ``.onnx``; the first axis is free.

    Args:
        mode: ``pixel`` or ``local``.
        latent: side of a latent; others than the released ones only in tests, as of ``context``.
        context: length of a token.
    """
    shapes = {
        "x": (None, 4, latent, latent),
        "timesteps": (None,),
        "context": (None, LENGTH, context),
        "camera": (None, CAMERA),
        "ip": (None, 257, FEATURES),
        "ip_img": (None, 4, latent, latent),
    }
    unet = {name: shapes[name] for name in UNET_INPUTS[: 6 if mode == "pixel" else 5]}
    picture = (None, 3, 8 * latent, 8 * latent)
    return {
        "text_encoder": Signature(
            {"input_ids": (None, LENGTH)}, {"hidden": (None, LENGTH, context)}, frozenset({"input_ids"})
        ),
        "image_encoder": Signature({"pixel_values": (None, 3, SIDE, SIDE)}, {"hidden": (None, 257, FEATURES)}),
        "unet": Signature(unet, {"eps": shapes["x"]}, frozenset({"timesteps"})),
        "vae_encoder": Signature({"image": picture}, {"moments": (None, 8, latent, latent)}),
        "vae_decoder": Signature({"latent": shapes["x"]}, {"image": picture}),
    }


class OnnxNetworks:
    """:class:`soar.priors.imagedream.networks.Networks` of an exported folder.

    Args:
        folder: with the five files.
        mode: ``pixel`` or ``local``, as it was exported.
        threads: of one inference.
        contract: names and shapes; others than :func:`signatures` only in tests.
    """

    def __init__(self, folder: Path, mode: str, threads: int, contract: dict[str, Signature] | None = None) -> None:
        self.folder, self.frames, self.threads = folder, FRAMES[mode], threads
        self.contract = contract or signatures(mode)

    def text(self, input_ids: Tensor) -> Tensor:
        """See :class:`~soar.priors.imagedream.networks.Networks`."""
        return self._run(self._open("text_encoder"), "text_encoder", input_ids)

    def image(self, pixel_values: Tensor) -> Tensor:
        """See :class:`~soar.priors.imagedream.networks.Networks`."""
        opened = self._open("image_encoder")
        return torch.cat([self._run(opened, "image_encoder", part) for part in pixel_values.split(1)])

    def encode(self, picture: Tensor) -> Tensor:
        """See :class:`~soar.priors.imagedream.networks.Networks`."""
        return self._run(self._encoder, "vae_encoder", picture)

    def decode(self, latent: Tensor) -> Tensor:
        """See :class:`~soar.priors.imagedream.networks.Networks`."""
        return self._run(self._decoder, "vae_decoder", latent)

    def noise(
        self, x: Tensor, timesteps: Tensor, context: Tensor, camera: Tensor, ip: Tensor, ip_img: Tensor | None
    ) -> Tensor:
        """See :class:`~soar.priors.imagedream.networks.Networks`."""
        given = (x, timesteps, context, camera, ip, ip_img)
        return self._run(self._unet, "unet", *(value for value in given if value is not None))

    @functools.cached_property
    def _unet(self) -> ort.InferenceSession:
        return self._open("unet")

    @functools.cached_property
    def _encoder(self) -> ort.InferenceSession:
        return self._open("vae_encoder")

    @functools.cached_property
    def _decoder(self) -> ort.InferenceSession:
        return self._open("vae_decoder")

    def _open(self, name: str) -> ort.InferenceSession:
        return session(self.folder / f"{name}.onnx", self.threads, self.contract[name])

    def _run(self, opened: ort.InferenceSession, name: str, *values: Tensor) -> Tensor:
        signature = self.contract[name]
        feed = {
            key: value.detach().numpy().astype(np.int64 if key in signature.integers else np.float32)
            for key, value in zip(signature.inputs, values, strict=True)
        }
        return torch.from_numpy(opened.run(list(signature.outputs), feed)[0])


def from_export(options: ImageDreamSettings, models: Path, threads: int) -> ImageDream:
    """The provider ``onnx``; files are opened when they are needed.

    Args:
        options: settings; ``form`` must be ``image``.
        models: ignored; the export brings its vocabulary.
        threads: of one inference.

    Raises:
        ConfigError: the settings ask for a gradient through the networks.
        ModelFileError: the folder lacks its vocabulary.
    """
    if options.form != "image":
        raise ConfigError(
            "the provider onnx has no gradient", expected="prior.form=image", got=f"prior.form={options.form}"
        )
    folder = Path(options.source)
    networks = OnnxNetworks(folder, options.mode, threads)
    return ImageDream(options, networks, tokenizer(folder / TOKENS), torch.device("cpu"))
