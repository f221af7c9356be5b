"""The direction of the positions: the mean over neighbours, shared with the mirror image."""

import torch

from soar.avatar.surfels import nearest
from soar.optimise.sobolev import Sobolev, reflected

LEFT = torch.tensor([1.0, 0.0, 0.0])


def symmetric_points(count: int = 40) -> torch.Tensor:
    half = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) + torch.tensor([0.1, 0.0, 0.0])
    return torch.cat([half, reflected(half, LEFT)])


def ring_of(points: torch.Tensor) -> torch.Tensor:
    return nearest(points, points, 4)[1]


def test_averaging_is_the_repeated_mean_of_the_neighbourhood() -> None:
    points = symmetric_points()
    ring, values = ring_of(points), torch.randn(len(points), 3, generator=torch.Generator().manual_seed(1))
    expected = values[ring].mean(1)[ring].mean(1)
    torch.testing.assert_close(Sobolev.of(points, ring, 2, LEFT, 0.0)(values), expected)
    torch.testing.assert_close(Sobolev.of(points, ring, 0, LEFT, 0.0)(values), values)


def test_a_push_on_one_side_is_mirrored_on_the_other() -> None:
    points = symmetric_points()
    push = torch.zeros_like(points)
    push[3] = torch.tensor([1.0, 2.0, -3.0])
    spread = Sobolev.of(points, ring_of(points), 0, LEFT, 1.0)(push)
    torch.testing.assert_close(spread[3], push[3] / 2)
    torch.testing.assert_close(spread[43], torch.tensor([-0.5, 1.0, -1.5]))
    assert int((spread.norm(dim=1) > 0).sum()) == 2


def test_equal_pushes_keep_their_size_and_opposite_ones_cancel() -> None:
    points = symmetric_points()
    push = torch.randn(len(points) // 2, 3, generator=torch.Generator().manual_seed(2))
    both = torch.cat([push, reflected(push, LEFT)])
    spread = Sobolev.of(points, ring_of(points), 0, LEFT, 1.0)
    torch.testing.assert_close(spread(both), both)
    torch.testing.assert_close(spread(torch.cat([push, -reflected(push, LEFT)])), torch.zeros_like(both))
