"""The networks of the released checkpoint, in torch: each is read when it is first needed."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Protocol, TypeVar

import torch
from torch import Tensor, nn

from soar.priors.imagedream.checkpoint import CLIP, UNET, VAE, Layout, plain
from soar.priors.imagedream.towers import Autoencoder, ImageTower, TextTower
from soar.priors.imagedream.unet import RELEASED, UNet

Made = TypeVar("Made", bound=nn.Module)

_BATCH = 16  # pictures that the image tower sees at once


class Networks(Protocol):
    """What the prior is made of: functions of float32 tensors on the device of the prior.

    Attributes:
        frames: pictures of an object that the U-Net takes: 4, or 5 with the image prompt as the last.
    """

    frames: int

    def text(self, input_ids: Tensor) -> Tensor:
        """(B, 77) token numbers to (B, 77, 1024); the network is dropped afterwards."""
        ...

    def image(self, pixel_values: Tensor) -> Tensor:
        """(B, 3, 224, 224) to (B, 257, 1280); the network is dropped afterwards."""
        ...

    def encode(self, picture: Tensor) -> Tensor:
        """(N, 3, 256, 256) in [-1, 1] to mean and log-variance (N, 8, 32, 32)."""
        ...

    def decode(self, latent: Tensor) -> Tensor:
        """(N, 4, 32, 32), not scaled, to (N, 3, 256, 256)."""
        ...

    def noise(
        self, x: Tensor, timesteps: Tensor, context: Tensor, camera: Tensor, ip: Tensor, ip_img: Tensor | None
    ) -> Tensor:
        """See :meth:`soar.priors.imagedream.unet.UNet.forward`."""
        ...


class Weights(Protocol):
    """Where weights come from: a :class:`soar.priors.imagedream.checkpoint.Checkpoint`."""

    def load(
        self,
        prefix: str,
        module: nn.Module,
        layout: Layout,
        spare: Callable[[str], bool],
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        """See :meth:`soar.priors.imagedream.checkpoint.Checkpoint.load`."""
        ...


class TorchNetworks:
    """:class:`Networks` in torch; :meth:`encode` has a gradient. Methods that read weights raise what ``weights`` do.

    Args:
        weights: of all parts.
        frames: 4 or 5.
        device: of all computations; on an accelerator they are done in half precision.
    """

    def __init__(self, weights: Weights, frames: int, device: torch.device) -> None:
        self.weights, self.frames, self.device = weights, frames, device
        self.dtype = torch.float32 if device.type == "cpu" else torch.float16

    def text(self, input_ids: Tensor) -> Tensor:
        """See :class:`Networks`."""
        with torch.no_grad():
            return self.text_tower()(input_ids.to(self.device)).float()

    def image(self, pixel_values: Tensor) -> Tensor:
        """See :class:`Networks`."""
        tower = self.image_tower()
        with torch.no_grad():
            return torch.cat([tower(part).float() for part in pixel_values.to(self.dtype).split(_BATCH)])

    def encode(self, picture: Tensor) -> Tensor:
        """See :class:`Networks`."""
        return self.autoencoder.encode(picture.to(self.dtype)).float()

    def decode(self, latent: Tensor) -> Tensor:
        """See :class:`Networks`."""
        return self.autoencoder.decode(latent.to(self.dtype)).float()

    def noise(
        self, x: Tensor, timesteps: Tensor, context: Tensor, camera: Tensor, ip: Tensor, ip_img: Tensor | None
    ) -> Tensor:
        """See :class:`Networks`."""
        parts = (None if part is None else part.to(self.dtype) for part in (context, camera, ip, ip_img))
        return self.unet(x.to(self.dtype), timesteps, *parts).float()

    def text_tower(self) -> TextTower:
        """The text tower, freshly read."""
        return self._tower(TextTower)

    def image_tower(self) -> ImageTower:
        """The image tower, freshly read."""
        return self._tower(ImageTower)

    @functools.cached_property
    def autoencoder(self) -> Autoencoder:
        """Kept once it is read."""
        made = planned(Autoencoder)
        return self._loaded(VAE, made, made.layout())

    @functools.cached_property
    def unet(self) -> UNet:
        """Kept once it is read."""
        made = planned(lambda: UNet(RELEASED, self.frames))
        return self._loaded(UNET, made, plain(made))

    def _tower(self, kind: type[TextTower] | type[ImageTower]) -> TextTower | ImageTower:
        made = planned(kind)
        return self._loaded(CLIP, made, made.layout(), made.spare)

    def _loaded(
        self, prefix: str, made: Made, layout: Layout, spare: Callable[[str], bool] = lambda key: False
    ) -> Made:
        self.weights.load(prefix, made, layout, spare, self.device, self.dtype)
        return made.to(self.device)


def planned(make: Callable[[], Made]) -> Made:
    """A module without weights: drawing random ones for a gigabyte takes longer than reading the right ones."""
    with torch.device("meta"):
        return make()
