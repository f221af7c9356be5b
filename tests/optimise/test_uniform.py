"""The step is shared: rows move in proportion to their gradients."""

import torch

from soar.optimise.uniform import UniformAdam


def test_the_first_step_moves_the_largest_row_by_the_rate_and_the_others_in_proportion() -> None:
    x = torch.zeros(3, 2, requires_grad=True)
    optimiser = UniformAdam([x], lr=0.1)
    x.grad = torch.tensor([[3.0, 4.0], [0.3, 0.4], [0.0, 0.0]])
    optimiser.step()
    torch.testing.assert_close(x.detach(), torch.tensor([[-0.06, -0.08], [-0.006, -0.008], [0.0, 0.0]]))


def test_it_finds_a_minimum_and_its_state_can_be_carried_over() -> None:
    def run(x: torch.Tensor, optimiser: UniformAdam, steps: int) -> None:
        for _ in range(steps):
            optimiser.zero_grad()
            ((x - torch.tensor([1.0, 2.0])) ** 2).sum().backward()
            optimiser.step()

    whole = torch.zeros(1, 2, requires_grad=True)
    run(whole, UniformAdam([whole], lr=0.05), 300)
    assert (whole - torch.tensor([1.0, 2.0])).abs().max() < 0.05
    part = torch.zeros(1, 2, requires_grad=True)
    first = UniformAdam([part], lr=0.05)
    run(part, first, 100)
    resumed = UniformAdam([part], lr=0.05)
    resumed.load_state_dict(first.state_dict())
    run(part, resumed, 200)
    assert torch.equal(part, whole)
