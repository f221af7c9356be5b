"""Masked metrics: definitions, independence of what is outside, and slow twins."""

import math

import numpy as np
import pytest

from soar.losses.lpips import Lpips
from soar.metrics.image import C1, C2, ssim
from soar.metrics.masked import iou, lpips_features, masked_mean, mlpips, mpsnr, mssim
from tests.conftest import model_file


@pytest.fixture
def images() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r = np.random.default_rng(3)
    a = r.random((40, 36, 3))
    mask = np.zeros((40, 36))
    mask[8:30, 6:25] = 1
    return a, np.clip(a + 0.1 * r.standard_normal(a.shape), 0, 1), mask


def test_mpsnr_is_the_masked_mean_square(images: tuple[np.ndarray, ...]) -> None:
    a, b, mask = images
    inside = mask > 0
    assert math.isclose(mpsnr(a, b, mask), -10 * math.log10(((a - b)[inside] ** 2).mean()))
    c = np.where(inside[..., None], a, 0.0)
    assert mpsnr(c, b, mask) == mpsnr(a, b, mask)


def test_empty_masks_are_nan(images: tuple[np.ndarray, ...]) -> None:
    a, b, mask = images
    assert math.isnan(mpsnr(a, b, 0 * mask))
    assert math.isnan(mssim(a, b, 0 * mask))
    assert math.isnan(iou(0 * mask, 0 * mask))
    assert math.isnan(masked_mean(a, 0 * mask))


def test_mssim_with_a_full_mask_is_the_gaussian_ssim(images: tuple[np.ndarray, ...]) -> None:
    a, b, mask = images
    assert math.isclose(mssim(a, b, np.ones_like(mask)), ssim(a, b, "gaussian"), abs_tol=1e-9)


def test_mssim_is_the_partial_convolution(images: tuple[np.ndarray, ...]) -> None:
    a, b, mask = images
    x = np.arange(11) - 5
    g = np.exp(-0.5 * (x / 1.5) ** 2)
    window = np.outer(g, g)[..., None]
    total = count = 0.0
    for row in range(5, 35):
        for column in range(5, 31):
            if mask[row, column] == 0:
                continue
            part = np.s_[row - 5 : row + 6, column - 5 : column + 6]
            w = window * mask[part][..., None]
            w = w / w.sum()
            ma, mb = (w * a[part]).sum((0, 1)), (w * b[part]).sum((0, 1))
            va, vb = (w * (a[part] - ma) ** 2).sum((0, 1)), (w * (b[part] - mb) ** 2).sum((0, 1))
            vab = (w * (a[part] - ma) * (b[part] - mb)).sum((0, 1))
            total += ((2 * ma * mb + C1) * (2 * vab + C2) / ((ma**2 + mb**2 + C1) * (va + vb + C2))).sum()
            count += 3
    assert math.isclose(mssim(a, b, mask), total / count, abs_tol=1e-6)


def test_iou() -> None:
    a, b = np.zeros((4, 4)), np.zeros((4, 4))
    a[:2], b[1:3] = 1, 0.6
    assert math.isclose(iou(a, b), 4 / 12)
    assert iou(a, a) == 1
    assert iou(a, 0.4 * a) == 0


def test_mlpips_ignores_what_is_outside_and_sees_what_is_inside() -> None:
    lpips = Lpips.load(model_file("lpips_alex.safetensors"), "alex")
    r = np.random.default_rng(0)
    a = r.random((64, 64, 3))
    mask = np.zeros((64, 64))
    mask[16:48, 16:48] = 1
    b = np.where(mask[..., None] > 0, a, 1 - a)
    c = np.where(mask[..., None] > 0, a[::-1], a)
    same, outside, inside = (lpips_features(image, lpips, mask) for image in (a, b, c))
    assert mlpips(outside, same, mask, lpips) < 1e-6
    assert mlpips(inside, same, mask, lpips) > 0.05
