"""The normal network: a residual on the body's normals, of unit length."""

import torch

from soar.config import settings
from soar.networks.normal_inputs import INPUTS, OUTPUTS
from soar.networks.normals import NormalNetwork, NormalNetworkSettings, unit
from tests.conftest import conf
from tests.networks.small import SETTINGS, network


def noise(count=2, height=16, width=24):
    generator = torch.Generator().manual_seed(3)
    return [torch.randn(count, planes, height, width, generator=generator) for planes in INPUTS.values()]


def test_untrained_network_gives_back_the_body():
    inputs = noise()
    outputs = NormalNetwork(SETTINGS)(*inputs)
    for given, got in zip((inputs[2], inputs[3]), outputs, strict=True):
        assert torch.allclose(got, torch.nn.functional.normalize(given, dim=1), atol=1e-5)


def test_outputs_are_unit_and_depend_on_every_input():
    inputs = [value.requires_grad_() for value in noise()]
    outputs = network()(*inputs)
    assert [tuple(value.shape) for value in outputs] == [(2, planes, 16, 24) for planes in OUTPUTS.values()]
    for value in outputs:
        assert torch.allclose(value.norm(dim=1), torch.ones(2, 16, 24), atol=1e-3)
        grads = torch.autograd.grad(value[:, 0].sum(), inputs, retain_graph=True)
        assert all(grad.abs().max() > 0 for grad in grads)


def test_unit_of_zero_is_zero():
    zero = torch.zeros(1, 3, 2, 2, requires_grad=True)
    unit(zero).sum().backward()
    assert not unit(zero).any()
    assert torch.isfinite(zero.grad).all()


def test_shipped_size_fits_its_bounds():
    """Of the size that was asked for: 1.3 to 3 million parameters."""
    made = NormalNetwork(settings(NormalNetworkSettings, conf("train", "normals")["network"]))
    assert 1.3e6 < sum(value.numel() for value in made.parameters()) < 3e6
    assert made.stride == conf("normals", "mini")["multiple"]
