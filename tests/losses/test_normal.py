"""Normal terms: signs of both sides, the picture's convention, gradients."""

import torch

from soar.losses.normal import cosine, normalise, picture


def planes(vector: list[float], height: int = 4, width: int = 5) -> torch.Tensor:
    return torch.tensor(vector, dtype=torch.float64)[:, None, None].expand(3, height, width).clone()


MASK = torch.ones(4, 5, dtype=torch.float64)


def test_cosine_is_zero_for_equal_directions_of_any_length_and_two_for_mirrored_ones() -> None:
    front, back = planes([0, 0, -1.0]), planes([0, 0, 1.0])
    assert float(cosine(0.3 * front, front, MASK)) < 1e-6
    assert abs(float(cosine(front, back, MASK)) - 2) < 1e-6


def test_cosine_looks_only_at_the_mask() -> None:
    rendered, target = planes([0, 0, -1.0]), planes([0, 0, -1.0])
    rendered[:, 0] = torch.tensor([0, 0, 1.0])[:, None]
    mask = MASK.clone()
    mask[0] = 0
    assert float(cosine(rendered, target, mask)) < 1e-6 < float(cosine(rendered, target, MASK))
    assert float(cosine(rendered, target, 0 * mask)) == 0


def test_a_normal_facing_the_camera_is_blue_and_one_pointing_up_is_green() -> None:
    torch.testing.assert_close(
        picture(planes([0, 0, -1.0]))[:, 0, 0], torch.tensor([0.5, 0.5, 1.0], dtype=torch.float64)
    )
    torch.testing.assert_close(
        picture(planes([0, -1.0, 0]))[:, 0, 0], torch.tensor([0.5, 1.0, 0.5], dtype=torch.float64)
    )


def test_gradients() -> None:
    generator = torch.Generator().manual_seed(0)
    rendered = torch.randn(3, 2, 2, dtype=torch.float64, generator=generator).requires_grad_()
    target = normalise(torch.randn(3, 2, 2, dtype=torch.float64, generator=generator))
    mask = torch.rand(2, 2, dtype=torch.float64, generator=generator)
    assert torch.autograd.gradcheck(lambda n: cosine(n, target, mask), (rendered,))
    zero = torch.zeros(3, 1, 1, requires_grad=True)
    normalise(zero).sum().backward()
    assert torch.isfinite(zero.grad).all()
