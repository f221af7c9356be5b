"""Colours: against published CIELAB values, in light and shade, of several cloths, and by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from soar.caption.colours import ColourNames, PaletteSettings, evenly_lit, exposure, lab, main_tones, srgb
from soar.config import settings
from tests.conftest import conf

TEMPLATE = conf("caption", "template")
PALETTE = settings(PaletteSettings, TEMPLATE["palette"])
NAMES = ColourNames(TEMPLATE["colours"], TEMPLATE["name_lightness"])


@pytest.mark.parametrize(
    ("rgb", "expected"),
    [((255, 0, 0), (53.24, 80.09, 67.20)), ((0, 0, 255), (32.30, 79.19, -107.86)), ((119, 119, 119), (50.03, 0, 0))],
)
def test_lab_of_known_colours(rgb: tuple, expected: tuple) -> None:
    found = lab(np.array([rgb], np.uint8))[0]
    assert np.allclose(found, expected, atol=0.35)
    assert np.allclose(np.array(srgb(found)) * 255, rgb, atol=1)


@given(st.tuples(*[st.integers(60, 250)] * 3), st.floats(0.3, 1.0))
def test_shade_changes_exposure_only(rgb: tuple[int, int, int], light: float) -> None:
    bright = np.array(rgb) / 255
    linear = np.where(bright <= 0.04045, bright / 12.92, ((bright + 0.055) / 1.055) ** 2.4) * light
    dark = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    a, b = lab(bright), lab(dark)
    assert np.allclose(evenly_lit(a), evenly_lit(b), atol=1.0)
    assert exposure(b, a) == pytest.approx(light ** (1 / 3), abs=0.01)


def cloth(*colours: tuple[tuple[int, int, int], int]) -> np.ndarray:
    """Pixels of plain cloth of several colours, each folded into light and shade."""
    rng = np.random.default_rng(0)
    parts = [(np.array(rgb) / 255) ** 2.2 * rng.uniform(0.5, 1, (count, 1)) for rgb, count in colours]
    return lab(np.concatenate(parts).astype(np.float32) ** (1 / 2.2))


def test_folds_are_no_second_colour() -> None:
    (tone,) = main_tones(cloth(((40, 85, 175), 2000)), PALETTE)
    assert tone.share == 1
    assert NAMES(tone.colour) == "blue"


def test_two_colours_are_two_unless_one_is_a_detail() -> None:
    both = main_tones(cloth(((235, 205, 60), 1500), ((40, 85, 175), 1000)), PALETTE)
    assert [NAMES(tone.colour) for tone in both] == ["yellow", "blue"]
    assert [tone.share for tone in both] == pytest.approx([0.6, 0.4], abs=0.02)
    assert len(main_tones(cloth(((235, 205, 60), 1500), ((40, 85, 175), 200)), PALETTE)) == 1


def test_the_order_of_pixels_says_nothing_and_few_are_enough() -> None:
    pixels = cloth(((185, 30, 40), 700), ((240, 240, 238), 500))
    mixed = np.random.default_rng(1).permutation(pixels)
    for a, b in zip(main_tones(pixels, PALETTE), main_tones(mixed, PALETTE), strict=True):
        assert np.allclose(a.colour, b.colour, atol=1e-3)
    assert main_tones(pixels[:1], PALETTE)[0].share == 1


@pytest.mark.parametrize(
    ("rgb", "word"),
    [
        ((5, 5, 5), "black"), ((250, 250, 250), "white"), ((30, 130, 160), "blue"), ((200, 30, 30), "red"),
        ((120, 200, 250), "light blue"), ((20, 30, 70), "dark blue"), ((60, 140, 60), "green"), ((30, 27, 10), "black"),
        ((250, 220, 60), "yellow"), ((100, 65, 40), "brown"),
    ],
)  # fmt: skip
def test_names(rgb: tuple[int, int, int], word: str) -> None:
    assert NAMES(lab(np.array(rgb, np.uint8))) == word


def test_every_hair_colour_is_a_colour() -> None:
    assert TEMPLATE["hair"].keys() < TEMPLATE["colours"].keys()
