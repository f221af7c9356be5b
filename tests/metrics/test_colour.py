"""The colour map between cameras is recovered exactly, and degenerate input is survived."""

import numpy as np

from soar.metrics.colour import calibrate


def test_gain_and_offset_are_recovered() -> None:
    x = np.random.default_rng(0).random((100, 3)) * 0.5
    gain, offset = np.array([1.1, 0.9, 1.25]), np.array([0.05, 0.0, 0.1])
    fitted = calibrate(x, x * gain + offset)
    np.testing.assert_allclose(fitted.gain, gain, rtol=1e-9)
    np.testing.assert_allclose(fitted.offset, offset, atol=1e-9)
    np.testing.assert_allclose(fitted(x), np.clip(x * gain + offset, 0, 1))


def test_it_never_worsens_the_mean_square() -> None:
    r = np.random.default_rng(1)
    x, y = r.random((50, 3)), r.random((50, 3))
    assert ((calibrate(x, y)(x) - y) ** 2).mean() <= ((x - y) ** 2).mean()


def test_flat_and_empty() -> None:
    flat = calibrate(np.full((5, 3), 0.2), np.full((5, 3), 0.5))
    np.testing.assert_allclose(flat(np.full((1, 3), 0.2)), 0.5)
    empty = calibrate(np.zeros((0, 3)), np.zeros((0, 3)))
    np.testing.assert_allclose(empty(np.full((1, 3), 0.3)), 0.3)
