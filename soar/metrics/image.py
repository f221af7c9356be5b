"""Whole-image metrics: peak signal-to-noise ratio and structural similarity, as scikit-image defines them."""

from __future__ import annotations

import math
from typing import Literal

import cv2
import numpy as np

C1, C2 = 0.01**2, 0.03**2


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of two images of the same shape in [0, 1]; infinite where they are equal."""
    return decibel(np.mean((np.asarray(image, np.float64) - truth) ** 2))


def decibel(mean_square: float) -> float:
    """Mean square error of values in [0, 1] as dB."""
    return math.inf if mean_square <= 0 else -10 * math.log10(mean_square)


def white_crop_psnr(image: np.ndarray, alpha: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR in dB over the whole crop with both images on white: the silhouette counts as much as the colours.

    Args:
        image: (H, W, 3) rendered colours, premultiplied by alpha (on black).
        alpha: (H, W) rendered alpha.
        truth: (H, W, 3) photograph in [0, 1].
        mask: (H, W) soft mask of the person in [0, 1].
    """
    return psnr(image + (1 - alpha[..., None]), truth * mask[..., None] + (1 - mask[..., None]))


def ssim(image: np.ndarray, truth: np.ndarray, window: Literal["uniform", "gaussian"] = "uniform") -> float:
    """Mean structural similarity of two (H, W, 3) images in [0, 1], averaged over channels.

    ``uniform``: 7 x 7 box with sample covariance, scikit-image's default (the paper's tables). ``gaussian``: 11 x 11,
    sigma 1.5, population covariance (Wang et al. 2004; torchmetrics). Only windows inside the image count.
    """
    a, b = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    radius = 3 if window == "uniform" else 5

    def mean(x: np.ndarray) -> np.ndarray:
        if window == "uniform":
            return cv2.blur(x, (7, 7))
        return cv2.GaussianBlur(x, (11, 11), 1.5)

    sample = 49 / 48 if window == "uniform" else 1.0
    ma, mb = mean(a), mean(b)
    vaa, vbb, vab = (sample * (mean(p) - q) for p, q in ((a * a, ma * ma), (b * b, mb * mb), (a * b, ma * mb)))
    value = (2 * ma * mb + C1) * (2 * vab + C2) / ((ma * ma + mb * mb + C1) * (vaa + vbb + C2))
    return float(value[radius:-radius, radius:-radius].mean())
