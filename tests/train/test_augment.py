"""Spoiling of pictures and masks: ranges, seeds, and that a setting of nothing does nothing."""

import dataclasses

import numpy as np
import pytest

from soar.config import settings
from soar.train.augment import MaskSettings, PhotoSettings, photograph, smooth_noise, spoilt_mask
from tests.conftest import conf

SAMPLES = conf("train", "normals")["samples"]
PHOTO, MASK = settings(PhotoSettings, SAMPLES["photo"]), settings(MaskSettings, SAMPLES["mask"])


def disc(size=64, radius=20):
    return (np.hypot(*(np.mgrid[:size, :size] - size / 2 + 0.5)) < radius).astype(np.float32)


def test_photograph_spoils_within_its_range_and_by_its_seed():
    image = np.random.default_rng(0).uniform(size=(40, 30, 3)).astype(np.float32)
    first, again, other = (photograph(np.random.default_rng(seed), image, PHOTO) for seed in (1, 1, 2))
    assert first.shape == image.shape
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_photograph_without_anything_to_spoil_is_exact():
    still = PhotoSettings(gain=0, gamma=1, saturation=1, blur_px=0, noise=0, jpeg=0, jpeg_quality=90)
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.float32) / 255
    assert np.array_equal(photograph(np.random.default_rng(3), image, still), np.round(255 * image).astype(np.uint8))


@pytest.mark.parametrize("field", ["gain", "blur_px", "noise"])
def test_every_setting_of_a_photograph_matters(field):
    still = PhotoSettings(gain=0, gamma=1, saturation=1, blur_px=0, noise=0, jpeg=0, jpeg_quality=90)
    image = np.random.default_rng(0).uniform(0.2, 0.8, (20, 30, 3)).astype(np.float32)
    changed = dataclasses.replace(still, **{field: 0.9 if field == "gain" else 2.0})
    outcomes = [photograph(np.random.default_rng(seed), image, changed) for seed in range(4)]
    clean = photograph(np.random.default_rng(0), image, still)
    assert any(np.abs(out.astype(int) - clean).mean() > 1 for out in outcomes)


def test_masks_stay_near_the_truth_and_fade_over_the_outline_only():
    truth, overlaps = disc(), []
    for seed in range(40):
        mask = spoilt_mask(np.random.default_rng(seed), truth, dataclasses.replace(MASK, blobs=0.0))
        assert mask.dtype == np.uint8
        inside = mask > 127
        overlaps.append((inside & (truth > 0)).sum() / (inside | (truth > 0)).sum())
        assert mask[30:34, 30:34].min() == 255
        assert mask[:4].max() == 0
    assert np.mean(overlaps) > 0.9
    assert np.std(overlaps) > 0.005


def test_blobs_remove_or_add_a_piece():
    truth = disc()
    quiet = MaskSettings(shift=0, wave=0, soft=0, blobs=1.0)
    sizes = [int((spoilt_mask(np.random.default_rng(seed), truth, quiet) > 127).sum()) for seed in range(20)]
    assert min(sizes) < truth.sum() - 5
    assert max(sizes) > truth.sum() + 5


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_empty_and_full_masks_stay(value):
    assert (spoilt_mask(np.random.default_rng(0), np.full((9, 7), value), MASK) == 255 * value).all()


def test_smooth_noise_is_smooth():
    noise = smooth_noise(np.random.default_rng(0), 64, 48, 4, 2)
    assert noise.shape == (64, 48, 2)
    assert np.abs(np.diff(noise, axis=0)).max() < 0.5 * noise.std() + 0.3
    assert 0.3 < noise.std() < 1.5
