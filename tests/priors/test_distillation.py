"""The bundled prior's gradient is that of score distillation, with the weight that docs/priors.md states."""

import numpy as np
import pytest
import torch

from soar.networks.diffusion import levels
from soar.priors.mini import MiniProvider
from soar.priors.protocol import VIEWS, Condition, Views
from tests.networks.small_prior import SIZE, inputs

ANSWER = np.random.default_rng(0).uniform(-0.9, 0.9, (VIEWS, 3, SIZE, SIZE)).astype(np.float32)


class Recorder:
    """A prior with one answer, which remembers the noisy pictures it was shown."""

    size = SIZE

    def __init__(self) -> None:
        self.shown: list[tuple[np.ndarray, float]] = []

    def __call__(self, noisy, time, given, guidance):
        self.shown.append((noisy, time))
        return ANSWER, None


@pytest.mark.parametrize("time", [0.1, 0.5, 0.95])
def test_the_gradient_is_weighted_score_distillation(time: float) -> None:
    given = {name: value[0] for name, value in inputs(1, seed=3).items()}
    alpha, geometry = given["alpha"], given["geometry"]
    pictures = (0.5 + 0.5 * torch.cat([given["noisy"], given["image"][None]]).clamp(-1, 1)) * alpha
    condition = Condition("colour", pictures[VIEWS], alpha[VIEWS], geometry[VIEWS], "")
    renders = pictures[:VIEWS].clone().requires_grad_()
    views = Views(renders, alpha[:VIEWS], geometry[:VIEWS], torch.arange(4) * 90.0, torch.zeros(4))
    prior = Recorder()
    loss = MiniProvider(prior, guidance=1.0).loss(condition, views, time, torch.Generator().manual_seed(5))
    (gradient,) = torch.autograd.grad(loss, renders)

    ((noisy, asked_at),) = prior.shown
    assert asked_at == time
    x_t, x0_hat = (torch.from_numpy(x).double() for x in (noisy, ANSWER))
    cos, sin = (level.double().item() for level in levels(torch.tensor([time])))
    assert cos**2 + sin**2 == pytest.approx(1)
    # What the provider distils in: renders in [-1, 1] before grey; d x / d renders = 2.
    x = (2 * renders - views.alpha).detach().double()
    eps = torch.randn(x.shape, generator=torch.Generator().manual_seed(5)).double()
    torch.testing.assert_close(x_t, cos * x + sin * eps, atol=1e-5, rtol=0)
    eps_hat = (x_t - cos * x0_hat) / sin
    score = sin / cos * (eps_hat - eps) / VIEWS
    assert score.abs().mean() > 0.05
    # The noisy pictures are float32: dividing them by cos enlarges their rounding.
    torch.testing.assert_close(gradient.double(), 2 * views.alpha * score, atol=5e-6 / cos, rtol=1e-4)
