"""The positions' direction and step against their formulas, where the two sides of the body are not alike."""

from __future__ import annotations

import numpy as np
import torch

from soar.avatar.surfels import nearest
from soar.optimise.sobolev import Sobolev
from soar.optimise.uniform import UniformAdam


def test_a_direction_is_averaged_first_and_mirrored_then() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.randn(30, 3, generator=generator).double()
    gradient = torch.randn(30, 3, generator=generator).double()
    ring, normal = nearest(points, points, 4)[1], np.array([0.6, 0.0, 0.8])
    mirror, weight = np.eye(3) - 2 * np.outer(normal, normal), 0.25

    expected = gradient.numpy().copy()
    for _ in range(2):
        expected = np.stack([expected[members].mean(0) for members in ring.numpy()])
    images = points.numpy() @ mirror
    twins = np.array([np.linalg.norm(points.numpy() - image, axis=1).argmin() for image in images])
    assert (twins[twins] != np.arange(30)).any()  # to be another's twin is not to have it for one's own
    expected = (expected + weight * expected[twins] @ mirror) / (1 + weight)

    spread = Sobolev.of(points, ring, 2, torch.from_numpy(normal), weight)
    torch.testing.assert_close(spread(gradient), torch.from_numpy(expected))


def test_the_shared_step_is_the_formula_over_several_steps_for_each_tensor_by_itself() -> None:
    generator, made = torch.Generator().manual_seed(1), []
    for rows, rate, betas in ((4, 0.1, (0.9, 0.999)), (3, 0.1, (0.9, 0.999)), (5, 0.02, (0.5, 0.9))):
        made.append((torch.randn(rows, 3, generator=generator).double().requires_grad_(), rate, betas))
    (a, rate, betas), (b, _, _), (c, other, slower) = made
    optimiser = UniformAdam([{"params": [a, b]}, {"params": [c], "lr": other, "betas": slower}], rate, betas)

    states = [(x.detach().numpy().copy(), np.zeros(x.shape), 0.0) for x, _, _ in made]
    for step in range(1, 7):
        for number, (x, rate, (first, second)) in enumerate(made):
            gradient = torch.randn(x.shape, generator=generator).double() * 10.0 ** (step % 3 - number)
            x.grad = gradient
            place, mean, square = states[number]
            mean = first * mean + (1 - first) * gradient.numpy()
            square = second * square + (1 - second) * (gradient.numpy() ** 2).sum(1).max()
            fair = mean / (1 - first**step), square / (1 - second**step)
            states[number] = place - rate * fair[0] / np.sqrt(fair[1]), mean, square
        optimiser.step()
        for (x, _, _), (place, _, _) in zip(made, states, strict=True):
            torch.testing.assert_close(x.detach(), torch.from_numpy(place), rtol=0, atol=1e-5)


def test_a_tensor_without_a_gradient_stays_and_one_whose_gradient_vanishes_has_numbers() -> None:
    still, flat = (torch.ones(2, 3, requires_grad=True) for _ in range(2))
    optimiser = UniformAdam([still, flat], lr=0.1)
    flat.grad = torch.zeros(2, 3)
    for _ in range(2):
        optimiser.step()
    assert torch.equal(still, torch.ones(2, 3))
    assert torch.equal(flat, torch.ones(2, 3))
    assert still not in optimiser.state
