"""Whole-image metrics against numbers computed once with scikit-image 0.26."""

import math

import numpy as np

from soar.metrics.image import psnr, ssim, white_crop_psnr


def pair() -> tuple[np.ndarray, np.ndarray]:
    r = np.random.default_rng(7)
    a = r.random((24, 31, 3))
    return a, np.clip(a + 0.1 * r.standard_normal(a.shape), 0, 1)


def test_psnr_and_ssim_agree_with_scikit_image() -> None:
    a, b = pair()
    assert math.isclose(psnr(a, b), 20.606741902277463, abs_tol=1e-9)
    assert math.isclose(ssim(a, b), 0.94617519035427, abs_tol=1e-9)
    assert math.isclose(ssim(a, b, "gaussian"), 0.9449770360136092, abs_tol=1e-9)


def test_equal_images() -> None:
    a, _ = pair()
    assert psnr(a, a) == math.inf
    assert math.isclose(ssim(a, a), 1)


def test_ssim_of_float32_is_close() -> None:
    a, b = pair()
    assert math.isclose(ssim(a.astype(np.float32), b.astype(np.float32)), 0.94617519035427, abs_tol=1e-6)


def test_white_crop_counts_the_silhouette() -> None:
    truth = np.full((4, 4, 3), 0.2)
    mask = np.zeros((4, 4))
    mask[1:3, 1:3] = 1
    assert white_crop_psnr(truth * mask[..., None], mask, truth, mask) == math.inf
    # One pixel of sixteen is missing: (1 - 0.2)^2 / 16.
    short = mask.copy()
    short[1, 1] = 0
    assert math.isclose(white_crop_psnr(truth * short[..., None], short, truth, mask), -10 * math.log10(0.64 / 16))
