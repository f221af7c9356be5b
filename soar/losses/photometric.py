"""Colour terms: L1, and structural similarity with the 11 x 11 Gaussian window of the Gaussian-splatting family."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import torch
from torch import Tensor

WINDOW = 11
SIGMA = 1.5
C1, C2 = 0.01**2, 0.03**2


def l1(image: Tensor, target: Tensor) -> Tensor:
    """Mean absolute difference of two images of the same shape."""
    return (image - target).abs().mean()


@functools.cache
def _kernel() -> np.ndarray:
    """(11,) the separable window, sum 1."""
    x = np.arange(WINDOW) - WINDOW // 2
    g = np.exp(-0.5 * (x / SIGMA) ** 2)
    return g / g.sum()


class _Blur(torch.autograd.Function):
    """Zero-padded Gaussian blur of planes (C, H, W). The window is symmetric, so the map is its own adjoint."""

    @staticmethod
    def forward(ctx, planes: Tensor) -> Tensor:
        return _blur(planes)

    @staticmethod
    def backward(ctx, grad: Tensor) -> Tensor:
        return _blur(grad)


def _blur(planes: Tensor) -> Tensor:
    if planes.device.type != "cpu":
        k = torch.as_tensor(_kernel(), dtype=planes.dtype, device=planes.device)
        x = torch.nn.functional.conv2d(planes[:, None], k.view(1, 1, 1, -1), padding=(0, WINDOW // 2))
        return torch.nn.functional.conv2d(x, k.view(1, 1, -1, 1), padding=(WINDOW // 2, 0))[:, 0]
    # OpenCV's separable filter is ten times faster than a depthwise convolution on a CPU.
    source = planes.detach().contiguous().numpy()
    out = np.empty_like(source)
    for plane, blurred in zip(source, out, strict=True):
        cv2.sepFilter2D(plane, -1, _kernel(), _kernel(), dst=blurred, borderType=cv2.BORDER_CONSTANT)
    return torch.from_numpy(out)


def blur(planes: Tensor) -> Tensor:
    """Gaussian-window means of planes (C, H, W), zero outside the image; differentiable once."""
    return _Blur.apply(planes)


@dataclasses.dataclass(frozen=True)
class SsimTarget:
    """The window moments of a target image, which need no gradient and are computed once per step or cached.

    Attributes:
        image: (3, H, W) in [0, 1].
        mean: (3, H, W) window means.
        variance: (3, H, W) window variances.
    """

    image: Tensor
    mean: Tensor
    variance: Tensor

    @staticmethod
    def of(image: Tensor) -> SsimTarget:
        """Moments of ``image`` (3, H, W)."""
        with torch.no_grad():
            mean, square = blur(torch.cat([image, image * image])).split(3)
            return SsimTarget(image, mean, square - mean * mean)


def ssim(image: Tensor, target: SsimTarget) -> Tensor:
    """Mean structural similarity in [-1, 1] of ``image`` (3, H, W) with range 1, zero padding (Wang et al. 2004)."""
    mean, square, product = blur(torch.cat([image, image * image, image * target.image])).split(len(image))
    variance = square - mean * mean
    covariance = product - mean * target.mean
    numerator = (2 * mean * target.mean + C1) * (2 * covariance + C2)
    return (numerator / ((mean * mean + target.mean**2 + C1) * (variance + target.variance + C2))).mean()
