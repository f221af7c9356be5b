"""The U-Net: shapes, sizes, and that it starts as nothing."""

import pytest
import torch

from soar.networks.blocks import Down, ResidualBlock, UNet, Up


def test_residual_block_starts_as_the_identity_and_learns():
    block, x = ResidualBlock(16), torch.randn(2, 16, 5, 7)
    assert torch.equal(block(x), x)
    block(x).square().sum().backward()
    assert block.conv2.weight.grad.abs().max() > 0


def test_down_and_up_change_the_size():
    x = torch.randn(1, 8, 6, 10)
    y = Down(8, 24)(x)
    assert y.shape == (1, 24, 3, 5)
    assert Up(24, 8)(y).shape == x.shape


@pytest.mark.parametrize(("height", "width"), [(8, 8), (24, 16), (40, 64)])
def test_unet_keeps_the_size_and_starts_at_zero(height, width):
    net = UNet(5, 3, (8, 16, 24), (1, 2, 1))
    assert net.stride == 8
    out = net(torch.randn(2, 5, height, width))
    assert out.shape == (2, 3, height, width)
    assert not out.any()


def test_every_parameter_gets_a_gradient_once_nothing_is_zero():
    net = UNet(5, 3, (8, 16, 24), (1, 2, 1))
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, 0, 0.1)
    net(torch.randn(1, 5, 16, 24)).square().sum().backward()
    assert all(parameter.grad.abs().max() > 0 for parameter in net.parameters())


def test_a_far_pixel_matters():
    """The deepest level sees the whole of a small picture."""
    net = UNet(1, 1, (8, 8, 8), (1, 1, 1))
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter, 0, 0.2)
    x = torch.zeros(1, 1, 32, 32, requires_grad=True)
    net(x)[0, 0, 0, 0].backward()
    assert x.grad[0, 0, 31, 31] != 0


@pytest.mark.parametrize(("widths", "depths"), [((8, 16), (1,)), ((8, 12), (1, 1))])
def test_impossible_sizes(widths, depths):
    with pytest.raises(ValueError, match="widths"):
        UNet(1, 1, widths, depths)
