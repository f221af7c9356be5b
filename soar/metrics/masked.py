"""Metrics over a part of the image: mPSNR, mSSIM and mLPIPS after DyCheck (Gao et al. 2022), and silhouette overlap."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from soar.losses.lpips import Features, Lpips
from soar.metrics.image import C1, C2, decibel


def masked_mean(values: np.ndarray, mask: np.ndarray) -> float:
    """Mean of ``values`` (H, W) or (H, W, C) with weights ``mask`` (H, W); NaN for an empty mask."""
    weights = mask[..., None] if values.ndim == 3 else mask
    total = float(np.broadcast_to(weights, values.shape).sum())
    return float((values * weights).sum() / total) if total > 0 else float("nan")


def mpsnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """PSNR in dB of (H, W, 3) images in [0, 1] inside a mask (H, W) in [0, 1]; NaN for an empty mask."""
    error = masked_mean((np.asarray(image, np.float64) - truth) ** 2, mask)
    return error if np.isnan(error) else decibel(error)


def mssim(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Masked structural similarity: windows see only masked pixels and are renormalised by what they see.

    11 x 11 Gaussian, sigma 1.5, windows inside the image only; variances are clamped at zero and the covariance at the
    geometric mean of the variances, since the renormalised moments need not be consistent.
    """

    def inside(x: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(x, (11, 11), 1.5)[5:-5, 5:-5]

    m = np.ascontiguousarray(mask, np.float64)
    coverage = inside(m)
    seen = coverage > 1e-8
    weight = np.where(seen, 1 / np.where(seen, coverage, 1), 0)[..., None]

    def mean(x: np.ndarray) -> np.ndarray:
        return inside(x * m[..., None]) * weight

    a, b = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    ma, mb = mean(a), mean(b)
    vaa, vbb = np.maximum(mean(a * a) - ma**2, 0), np.maximum(mean(b * b) - mb**2, 0)
    vab = mean(a * b) - ma * mb
    vab = np.sign(vab) * np.minimum(np.abs(vab), np.sqrt(vaa * vbb))
    value = (2 * ma * mb + C1) * (2 * vab + C2) / ((ma**2 + mb**2 + C1) * (vaa + vbb + C2))
    return masked_mean(value, m[5:-5, 5:-5] * seen)


def lpips_features(image: np.ndarray, lpips: Lpips, mask: np.ndarray | None = None) -> Features:
    """LPIPS features of an image (H, W, 3) in [0, 1], made black outside a mask (H, W) if there is one."""
    shown = image if mask is None else image * mask[..., None]
    return lpips.features(torch.from_numpy(np.ascontiguousarray(shown.transpose(2, 0, 1), np.float32))[None])


def mlpips(image: Features, truth: Features, mask: np.ndarray, lpips: Lpips) -> float:
    """LPIPS inside a mask (H, W), given the :func:`lpips_features` of both images in it: its map averaged there."""
    spread = lpips.spatial(image, truth, mask.shape)
    return masked_mean(spread[0, 0].numpy().astype(np.float64), mask)


def iou(alpha: np.ndarray, mask: np.ndarray, threshold: float = 0.5) -> float:
    """Intersection over union of two soft masks (H, W), both thresholded; NaN where both are empty."""
    a, b = alpha > threshold, mask > threshold
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else float("nan")
