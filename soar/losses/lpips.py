"""LPIPS v0.1, a learned perceptual distance between images (Zhang et al., "The Unreasonable Effectiveness of Deep
Features as a Perceptual Metric", CVPR 2018), with frozen AlexNet or VGG-16 trunk.

Features of a fixed target are worth keeping: ``target = lpips.features(image)`` once, then
``lpips.distance(lpips.features(render), target)`` at every step costs one pass of the trunk, not two.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from soar.artifacts import read_tensors
from soar.errors import ArtifactError, ModelFileError
from soar.models import records
from soar.models.catalogue import fetch_command

Features = list[Tensor]
Net = Literal["alex", "vgg"]

# LPIPS scales images to [-1, 1], then subtracts (-0.030, -0.088, -0.188) and divides by (0.458, 0.448, 0.450). On
# [0, 1] both steps together are the ImageNet normalisation.
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_EPS = 1e-10  # added to the norm of a feature vector, outside the root, as in the reference implementation
_SMALLEST = 32  # pixels; below, the last layers have no cells


@dataclasses.dataclass(frozen=True)
class _Trunk:
    """A convolutional trunk: (out, in, kernel, stride, padding) per layer, each followed by a ReLU."""

    convolutions: tuple[tuple[int, int, int, int, int], ...]
    pool_before: tuple[int, ...]
    pool_size: int
    taps: tuple[int, ...]


def _vgg_layers(*widths: int) -> tuple[tuple[int, int, int, int, int], ...]:
    return tuple((out, before, 3, 1, 1) for before, out in zip((3, *widths), widths, strict=False))


_TRUNKS: dict[str, _Trunk] = {
    "alex": _Trunk(
        ((64, 3, 11, 4, 2), (192, 64, 5, 1, 2), (384, 192, 3, 1, 1), (256, 384, 3, 1, 1), (256, 256, 3, 1, 1)),
        pool_before=(1, 2),
        pool_size=3,
        taps=(0, 1, 2, 3, 4),
    ),
    "vgg": _Trunk(
        _vgg_layers(64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
        pool_before=(2, 4, 7, 10),
        pool_size=2,
        taps=(1, 3, 6, 9, 12),
    ),
}


class Lpips(nn.Module):
    """The distance, as a module whose weights are buffers: they follow ``.to`` and never receive a gradient.

    Args:
        net: ``alex`` (evaluation, fast) or ``vgg`` (training loss).
        tensors: ``conv{i}.weight``, ``conv{i}.bias`` and ``head{k}.weight``, as ``soar.models`` stores them.

    Raises:
        ModelFileError: a tensor is missing, unknown, or of another shape.
    """

    def __init__(self, net: Net, tensors: dict[str, Tensor]) -> None:
        super().__init__()
        self.trunk = _TRUNKS[net]
        expected: dict[str, tuple[int, ...]] = {}
        for i, (out, before, kernel, _, _) in enumerate(self.trunk.convolutions):
            expected[f"conv{i}.weight"], expected[f"conv{i}.bias"] = (out, before, kernel, kernel), (out,)
        for k, tap in enumerate(self.trunk.taps):
            expected[f"head{k}.weight"] = (1, self.trunk.convolutions[tap][0], 1, 1)
        found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
        wrong = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
        if wrong:
            raise ModelFileError(
                f"LPIPS {net} weights do not fit the network at {wrong[0]}",
                expected=str(expected.get(wrong[0], "no such tensor")),
                got=str(found.get(wrong[0], "missing")),
                cure="use the weights that `python -m soar models fetch` brings",
            )
        self.register_buffer("mean", torch.tensor(_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(_STD).view(3, 1, 1), persistent=False)
        for name, tensor in tensors.items():
            self.register_buffer(name.replace(".", "_"), tensor, persistent=False)

    @classmethod
    def load(cls, path: str | os.PathLike[str], net: Net) -> Lpips:
        """Read the weights from a safetensors file.

        Raises:
            ModelFileError: the file is missing, truncated, altered since it was installed, or of another network.
        """
        path = Path(path)
        try:
            records.check(path.parent, path.name)
            tensors, _ = read_tensors(path)
        except ArtifactError as error:
            raise ModelFileError(error.what, cure=f"delete the file and run {fetch_command(path.name)}") from error
        return cls(net, tensors)

    def features(self, images: Tensor) -> Features:
        """Unit-length feature vectors of the five taps.

        Args:
            images: (B, 3, H, W) sRGB in [0, 1], H and W at least 32.

        Returns:
            five tensors (B, C_k, H_k, W_k), finest first.

        Raises:
            ValueError: the images have another shape or are too small.
        """
        if images.ndim != 4 or images.shape[1] != 3 or min(images.shape[2:]) < _SMALLEST:
            raise ValueError(f"expected images (B, 3, H, W) of at least {_SMALLEST} pixels, got {tuple(images.shape)}")
        x = (images - self.mean) / self.std
        taps: Features = []
        for i, (_, _, _, stride, padding) in enumerate(self.trunk.convolutions):
            if i in self.trunk.pool_before:
                x = F.max_pool2d(x, self.trunk.pool_size, stride=2)
            weight, bias = self.get_buffer(f"conv{i}_weight"), self.get_buffer(f"conv{i}_bias")
            x = F.relu(F.conv2d(x, weight, bias, stride, padding))
            if i in self.trunk.taps:
                taps.append(x / (torch.linalg.vector_norm(x, dim=1, keepdim=True) + _EPS))
        return taps

    def _layers(self, a: Features, b: Features) -> list[Tensor]:
        """Weighted squared difference of each tap, (B, 1, H_k, W_k)."""
        return [
            F.conv2d((x - y) ** 2, self.get_buffer(f"head{k}_weight"))
            for k, (x, y) in enumerate(zip(a, b, strict=True))
        ]

    def distance(self, a: Features, b: Features) -> Tensor:
        """LPIPS of images given their features: spatial mean of each tap, summed; (B,), 0 = equal."""
        return torch.stack([layer.mean(dim=(1, 2, 3)) for layer in self._layers(a, b)]).sum(dim=0)

    def spatial(self, a: Features, b: Features, size: tuple[int, int]) -> Tensor:
        """LPIPS per pixel: each tap's difference upsampled bilinearly to ``size`` = (H, W), summed; (B, 1, H, W)."""
        maps = [F.interpolate(x, size, mode="bilinear", align_corners=False) for x in self._layers(a, b)]
        return torch.stack(maps).sum(dim=0)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """LPIPS of two batches of images (B, 3, H, W) in [0, 1]; (B,)."""
        return self.distance(self.features(a), self.features(b))
