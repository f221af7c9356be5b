"""Drawing helpers: sizes and golden colours."""

from __future__ import annotations

import numpy as np
import pytest

from soar.report.pictures import (
    colour_normals,
    colour_occlusion,
    composite,
    fit,
    grid,
    label,
    overlay_mask,
    to_float,
    to_uint8,
)


@pytest.mark.parametrize(
    ("normal", "colour"),
    [
        ((0, 0, -1), (128, 128, 255)),  # faces the camera: light blue
        ((0, 0, 1), (128, 128, 0)),  # faces away: olive
        ((1, 0, 0), (255, 128, 128)),  # to the right of the image: red
        ((0, -1, 0), (128, 255, 128)),  # up in the image: green
        ((0, 0, 0), (255, 255, 255)),  # no surface: background
    ],
)
def test_normal_colours(normal: tuple, colour: tuple) -> None:
    image = np.broadcast_to(np.array(normal, np.float32), (2, 3, 3))
    assert (colour_normals(image) == colour).all()
    assert (colour_normals((image * 127).astype(np.int8)) == colour).all()


def test_normals_are_normalised_before_colouring() -> None:
    assert (colour_normals(np.full((1, 1, 3), (0, 0, -0.4), np.float32)) == (128, 128, 255)).all()


def test_occlusion_colours() -> None:
    tau, alpha = np.array([[0.0, 1.0, 1.0]]), np.array([[1.0, 1.0, 0.0]])
    seen, unseen, background = colour_occlusion(tau, alpha)[0].astype(int)
    assert np.ptp(seen) < 10
    assert seen.min() > 200
    assert unseen[0] > 200
    assert unseen[1:].max() < 60
    assert (background == 255).all()


def test_composite_is_linear_in_alpha() -> None:
    colour = np.full((1, 3, 3), (1.0, 0.0, 0.5), np.float32)
    out = composite(colour, np.array([[0.0, 0.5, 1.0]]), (0.0, 1.0, 0.5))
    np.testing.assert_allclose(out[0], [[0, 1, 0.5], [0.5, 0.5, 0.5], [1, 0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(composite(to_uint8(colour), np.full((1, 3), 255, np.uint8)), colour, atol=1 / 255)


def test_conversions_clip_and_round() -> None:
    assert to_uint8(np.array([[-1.0, 0.5, 2.0]]))[0, :, 0].tolist() == [0, 128, 255]
    assert to_uint8(np.array([[True, False]])).tolist() == [[[255] * 3, [0] * 3]]
    assert to_float(np.array([255, 0], np.uint8)).tolist() == [1.0, 0.0]


def test_overlay_tints_inside_and_leaves_outside() -> None:
    image, mask = np.zeros((20, 20, 3), np.uint8), np.zeros((20, 20), np.uint8)
    mask[5:15, 5:15] = 255
    out = overlay_mask(image, mask, (1.0, 0.0, 0.0), 0.5)
    assert out[10, 10].tolist() == [128, 0, 0]
    assert out[5, 10, 0] > 200  # the outline
    assert out[0, 0].tolist() == [0, 0, 0]
    assert image.max() == 0  # the input is untouched


def test_fit_keeps_the_aspect_ratio() -> None:
    out = fit(np.zeros((10, 20, 3), np.uint8), 40, 40)
    assert out.shape == (40, 40, 3)
    dark = (out < 128).all(-1)
    assert dark.any(1).sum() == 20
    assert dark.any(0).sum() == 40


@pytest.mark.parametrize(("count", "columns", "rows", "used"), [(1, 4, 1, 1), (4, 2, 2, 2), (5, 3, 2, 3)])
def test_grid_size(count: int, columns: int, rows: int, used: int) -> None:
    images = [np.full((30, 40, 3), i, np.uint8) for i in range(count)]
    sheet = grid(images, columns, gap=2)
    assert sheet.shape == (rows * 32 - 2, used * 42 - 2, 3)
    for i in range(count):
        assert (sheet[(i // used) * 32, (i % used) * 42] == i).all()


def test_grid_of_unequal_images_and_labels() -> None:
    sheet = grid([np.zeros((30, 40, 3)), np.zeros((20, 50))], 2, ["first", "second"], gap=0)
    strip = label(np.zeros((30, 50, 3)), "x").shape[0] - 30
    assert sheet.shape == (30 + strip, 100, 3)
    with pytest.raises(ValueError, match="argument"):
        grid([np.zeros((3, 3))], 1, ["one", "too many"])


def test_label_draws_text_above_and_leaves_the_picture() -> None:
    image = np.full((16, 120, 3), 7, np.uint8)
    blank, out = label(image, ""), label(image, "τ = 0.28")
    assert (out[-16:] == 7).all()
    assert out.shape == blank.shape
    assert (out != blank).sum() > 50


def test_a_long_label_is_drawn_smaller() -> None:
    image = np.zeros((4, 160, 3), np.uint8)
    text = "m" * 16
    rows = (label(image, text)[:-4] > 150).any((1, 2)).sum()
    assert 0 < rows < (label(np.zeros((4, 600, 3), np.uint8), text)[:-4] > 150).any((1, 2)).sum()
