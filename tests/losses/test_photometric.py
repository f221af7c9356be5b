"""Blur and SSIM against slow twins, and gradients in float64."""

import numpy as np
import torch

from soar.losses.photometric import C1, C2, SsimTarget, _kernel, blur, l1, ssim


def image(seed: int, height: int = 19, width: int = 14) -> torch.Tensor:
    return torch.rand(3, height, width, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def slow_blur(planes: torch.Tensor) -> torch.Tensor:
    """The same map as a zero-padded two-dimensional convolution."""
    window = torch.from_numpy(np.outer(_kernel(), _kernel())).to(planes)
    return torch.nn.functional.conv2d(planes[:, None], window[None, None], padding=5)[:, 0]


def test_the_window_sums_to_one() -> None:
    assert _kernel().shape == (11,)
    assert np.isclose(_kernel().sum(), 1)


def test_blur_is_the_convolution_in_both_precisions() -> None:
    x = image(0)
    torch.testing.assert_close(blur(x), slow_blur(x), atol=1e-12, rtol=0)
    torch.testing.assert_close(blur(x.float()), slow_blur(x).float(), atol=1e-6, rtol=0)


def test_blur_gradient() -> None:
    x = image(1, 6, 5).requires_grad_()
    assert torch.autograd.gradcheck(blur, (x,))


def test_ssim_is_the_definition() -> None:
    a, b = image(2), image(3)
    ma, mb = slow_blur(a), slow_blur(b)
    va, vb, vab = slow_blur(a * a) - ma * ma, slow_blur(b * b) - mb * mb, slow_blur(a * b) - ma * mb
    truth = ((2 * ma * mb + C1) * (2 * vab + C2) / ((ma**2 + mb**2 + C1) * (va + vb + C2))).mean()
    torch.testing.assert_close(ssim(a, SsimTarget.of(b)), truth, atol=1e-12, rtol=0)
    torch.testing.assert_close(ssim(a, SsimTarget.of(a)), torch.ones((), dtype=torch.float64))


def test_ssim_and_l1_gradients() -> None:
    a, target = image(4, 7, 6).requires_grad_(), image(5, 7, 6)
    assert torch.autograd.gradcheck(lambda x: ssim(x, SsimTarget.of(target)), (a,))
    assert torch.autograd.gradcheck(lambda x: l1(x, target), (a,))


def test_the_target_gets_no_gradient() -> None:
    b = image(6).requires_grad_()
    assert not SsimTarget.of(b).mean.requires_grad
    assert not SsimTarget.of(b).variance.requires_grad
