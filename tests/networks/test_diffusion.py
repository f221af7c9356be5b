"""Noise and its removal: the ends of the schedule, and sampling with denoisers whose answer is known."""

import pytest
import torch

from soar.networks.diffusion import levels, noised, sample


def normal(seed, count=2):
    return torch.randn(count, 4, 3, 5, 6, generator=torch.Generator().manual_seed(seed))


def test_ends_of_the_schedule():
    x0, noise = normal(0), normal(1)
    assert torch.equal(noised(x0, noise, torch.zeros(2)), x0)
    torch.testing.assert_close(noised(x0, noise, torch.ones(2)), noise, atol=1e-6, rtol=0)
    half = torch.full((2,), 0.5)
    torch.testing.assert_close(noised(x0, noise, half), (x0 + noise) / 2**0.5)


def test_levels_keep_the_variance_and_fall():
    alpha, sigma = levels(torch.linspace(0, 1, 101))
    assert alpha.shape == sigma.shape == (101, 1, 1, 1, 1)
    torch.testing.assert_close(alpha**2 + sigma**2, torch.ones_like(alpha))
    assert (alpha.diff(dim=0) < 0).all()
    assert (sigma.diff(dim=0) > 0).all()


def test_every_sample_has_its_own_time():
    x0, noise = normal(0), normal(1)
    both = noised(x0, noise, torch.tensor([0.2, 0.7]))
    for index, time in enumerate((0.2, 0.7)):
        torch.testing.assert_close(both[index], noised(x0, noise, torch.tensor([time, time]))[index])


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_a_denoiser_that_knows_gets_the_truth_back(steps):
    """On the way every noisy picture is the truth with the very noise that was started from."""
    x0, noise = normal(0), normal(1)
    asked = []

    def denoise(x, t):
        torch.testing.assert_close(x, noised(x0, noise, t), atol=1e-5, rtol=0)
        asked.append(t)
        return x0

    torch.testing.assert_close(sample(denoise, noise, steps), x0)
    torch.testing.assert_close(torch.stack(asked)[:, 0], torch.arange(steps, 0, -1) / steps)
    assert all(t.shape == (2,) for t in asked)


def test_the_last_answer_is_the_result():
    answers = iter(torch.arange(3.0))
    got = sample(lambda x, t: torch.full_like(x, next(answers)), normal(1), 3)
    assert torch.equal(got, torch.full_like(got, 2.0))


def test_many_steps_carry_noise_to_the_data():
    """Data of N(mean, 0.3^2) have the denoiser written out here; noise z must become mean + 0.3 z."""
    mean, deviation, noise = 0.4, 0.3, normal(1)

    def denoise(x, t):
        alpha, sigma = levels(t)
        gain = alpha * deviation**2 / (alpha**2 * deviation**2 + sigma**2)
        return mean + gain * (x - alpha * mean)

    errors = [(sample(denoise, noise, steps) - mean - deviation * noise).abs().max() for steps in (10, 100)]
    assert errors[1] < 0.03
    assert errors[1] < 0.2 * errors[0]
