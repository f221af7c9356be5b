"""How strong colours are: known values, and the order of the channels does not count."""

import numpy as np
import pytest

from soar.metrics.colour import saturation


@pytest.mark.parametrize(
    ("colour", "expected"),
    [
        ((0.4, 0.4, 0.4), 0.0),
        ((0.0, 0.0, 0.0), 0.0),
        ((1.0, 0.0, 0.0), 1.0),
        ((0.0, 0.0, 1.0), 1.0),
        ((0.2, 0.9, 0.5), 0.7),
    ],
)
def test_one_colour(colour: tuple[float, float, float], expected: float) -> None:
    assert saturation(np.array([colour])) == pytest.approx(expected)


def test_it_is_the_mean_over_colours_not_that_of_their_mean() -> None:
    red_and_cyan = np.array([[1.0, 0, 0], [0, 1.0, 1.0], [0.5, 0.5, 0.5]], np.float32)
    assert saturation(red_and_cyan) == pytest.approx(2 / 3)
    assert saturation(red_and_cyan[::-1, [2, 0, 1]]) == pytest.approx(2 / 3)
