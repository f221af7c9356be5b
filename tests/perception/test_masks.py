"""Pieces of the mask estimator on synthetic pictures."""

from __future__ import annotations

import numpy as np
import pytest

from soar.body.openpose import INDEX
from soar.perception.diagnostics import area_jitter, mask_figures
from soar.perception.masks import keep_touching, paste, skeleton, support, window
from soar.perception.roi import Roi


def test_only_components_under_the_skeleton_are_kept():
    alpha = np.zeros((100, 100), np.float32)
    alpha[10:60, 10:40] = 1
    alpha[10:60, 60:90] = 1
    alpha[80:90, 20:30] = 0.9
    alpha[8:10, 10:40] = 0.3  # soft edge of the first
    alpha[70, 95] = 0.4  # stray haze
    touch = np.zeros((100, 100), np.uint8)
    touch[20:85, 20] = 1
    kept = keep_touching(alpha, touch, 3)
    assert (kept[10:60, 10:40] == 1).all()
    assert (kept[80:90, 20:30] == np.float32(0.9)).all()
    assert not kept[:, 60:].any()
    assert (kept[8:10, 10:40] == np.float32(0.3)).all()
    assert not keep_touching(alpha, np.zeros_like(touch), 3).any()


def test_skeleton_draws_trusted_bones_only():
    body = np.zeros((25, 3))
    body[INDEX["left_hip"]] = (20, 10, 0.9)
    body[INDEX["left_knee"]] = (20, 50, 0.9)
    body[INDEX["left_ankle"]] = (20, 90, 0.1)
    drawn = skeleton(body, (100, 100), 0.3, 3)
    assert drawn[30, 20] == 1
    assert drawn[70, 20] == 0
    assert drawn[30, 50] == 0


@pytest.mark.parametrize("mirrored", [False, True])
def test_pasting_undoes_the_crop(mirrored):
    image = np.zeros((200, 160, 3), np.uint8)
    image[60:140, 50:100] = 255
    roi = Roi(80.0, 100.0, 128.0, 0.3)
    crop = roi.crop(image, 256, border=0, mirrored=mirrored)[..., 0].astype(np.float32) / 255
    rect = (10, 20, 150, 190)
    back = paste(crop, roi, mirrored, rect) > 0.5
    truth = image[20:190, 10:150, 0] > 0
    assert (back ^ truth).sum() < 0.03 * truth.sum()


def test_window_covers_the_turned_square_and_stops_at_the_image():
    assert window(Roi(50, 50, 20, 0.0), 1.0, 100, 100) == (40, 40, 60, 60)
    x0, _, x1, _ = window(Roi(50, 50, 20, np.pi / 4), 1.0, 100, 100)
    assert (x0, x1) == (35, 65)
    assert window(Roi(5, 95, 20, 0.0), 1.0, 100, 100) == (0, 85, 15, 100)
    x0, _, x1, _ = window(Roi(-80, 50, 20, 0.0), 1.0, 100, 100)
    assert x0 == x1


def test_support():
    mask = np.zeros((50, 60), np.float32)
    mask[20:30, 5:9] = 0.2
    rows, columns = support(mask, 3)
    assert (rows, columns) == (slice(17, 33), slice(2, 12))
    assert mask[support(np.zeros_like(mask), 3)].size == 0


def test_figures():
    alpha = np.zeros((20, 20), np.float32)
    alpha[5:9, 5:9], alpha[15:20, 3:5], alpha[0, 0] = 1, 0.7, 0.4
    figures = mask_figures(alpha)
    assert (figures.area, figures.components, figures.at_border) == (26, 2, True)
    assert not mask_figures(alpha[:12]).at_border
    assert area_jitter(np.array([100.0, 110, 120, 130])) == 0
    assert area_jitter(np.array([100.0, 120, 100, 120, 100])) == pytest.approx(0.4)
    assert np.isnan(area_jitter(np.array([100.0, 0, 100])))
