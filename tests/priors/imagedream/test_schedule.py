"""The noise schedule is Stable Diffusion's; the estimate of clean latents and its contrast are the formulas."""

import pytest
import torch

from soar.priors.imagedream.schedule import STEPS, alphas_cumprod, clean, levels, rescaled, step_at
from tests.priors.imagedream.small import wave


@pytest.mark.parametrize(
    ("step", "ratio", "variance"),
    [(20, 0.138, 0.019), (100, 0.344, 0.106), (250, 0.696, 0.326), (500, 1.618, 0.724), (625, 2.50, 0.862),
     (750, 4.10, 0.944), (980, 13.0, 0.994)],
)  # fmt: skip
def test_levels(step, ratio, variance):
    alpha, sigma = levels(step)
    assert sigma / alpha == pytest.approx(ratio, rel=4e-3)
    assert sigma**2 == pytest.approx(variance, abs=6e-4)
    assert alpha**2 + sigma**2 == pytest.approx(1)


def test_schedule_falls_from_first_to_last():
    squares = alphas_cumprod()
    assert squares.shape == (STEPS,)
    assert squares[0].item() == pytest.approx(1 - 0.00085)
    assert (squares.diff() < 0).all()


def test_steps_of_times():
    assert [step_at(time) for time in (0.0, 0.02, 0.5, 0.98, 1.0)] == [0, 20, 500, 980, 999]


def test_clean_undoes_the_noise():
    latent, noise = wave(0.3, 0, 4, 4, 2, 2), wave(0.7, 1, 4, 4, 2, 2)
    alpha, sigma = levels(700)
    torch.testing.assert_close(clean(alpha * latent + sigma * noise, noise, 700), latent)


def test_rescaling_takes_the_contrast_of_the_whole_group():
    guided, conditional = 3 * wave(0.3, 0, 4, 4, 2, 2) + 1, wave(0.9, 1, 4, 4, 2, 2)
    assert torch.equal(rescaled(guided, conditional, 0.0), guided)
    full = rescaled(guided, conditional, 1.0)
    torch.testing.assert_close(full.std(), conditional.std())
    torch.testing.assert_close(full / guided, torch.full_like(guided, (conditional.std() / guided.std()).item()))
    torch.testing.assert_close(rescaled(guided, conditional, 0.2), 0.2 * full + 0.8 * guided)
