"""The multi-view prior: what its output is made of, what it depends on, and its file."""

import dataclasses

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from soar.artifacts import read_json
from soar.config import settings
from soar.errors import ConfigError, ModelFileError
from soar.models.onnx import session
from soar.networks.diffusion import levels
from soar.networks.export import difference, export
from soar.networks.prior import PriorNetwork, PriorNetworkSettings
from soar.networks.prior_inputs import ALPHA_KNOWN, DOMAIN, RULES, VIEWS, signature
from tests.conftest import conf
from tests.networks.small_prior import SETTINGS, SIZE, inputs, network


def run(made, given):
    with torch.no_grad():
        return made(**given)


def evenly():
    """An untrained network that looks at all of the picture alike."""
    made = PriorNetwork(SETTINGS)
    torch.nn.init.zeros_(made.query.weight)
    torch.nn.init.zeros_(made.query.bias)
    return made


def candidates(given):
    """(N, 4, 6, 3, H, W): the carried colours, the picture's mean colour, the noisy view times alpha."""
    colours, share = (F.avg_pool2d(x, 4).flatten(2) for x in (given["image"], given["alpha"][:, VIEWS]))
    known = (share > 0.05).float()
    mean = (known * colours / share.clamp_min(1e-6)).sum(2) / known.sum(2)
    copies = given["carried"][:, :, : 3 * RULES].unflatten(2, (RULES, 3))
    looked_up = mean[:, None, None, :, None, None].expand_as(copies[:, :, :1])
    return torch.cat([copies, looked_up, (levels(given["time"])[0] * given["noisy"])[:, :, None]], 2)


@pytest.mark.parametrize("size", [8, 16, 24])
def test_shapes_and_ranges(size):
    clean, coverage = run(network(), inputs(2, size=size))
    assert clean.shape == (2, VIEWS, 3, size, size)
    assert coverage.shape == (2, VIEWS, 1, size, size)
    assert 0 <= coverage.min() < coverage.max() <= 1


def test_untrained_network_is_an_even_mixture():
    given = inputs()
    clean, coverage = run(evenly(), given)
    torch.testing.assert_close(clean, candidates(given).sum(2) / 7, atol=1e-5, rtol=0)
    torch.testing.assert_close(coverage, torch.full_like(coverage, 6 / 7))


def test_without_the_picture_it_is_paint_and_background_and_of_normal_maps_the_bodys():
    given = inputs(conditioned=0.0)
    normal = given["flags"][:, DOMAIN] == 1
    clean, coverage = run(evenly(), given)
    left = candidates(given)
    torch.testing.assert_close(clean[~normal], left[~normal, :, 5] / 2, atol=1e-6, rtol=0)
    torch.testing.assert_close(coverage[~normal], torch.full_like(coverage[~normal], 1 / 2))
    own = [0, 1, 2, 3, 5]
    torch.testing.assert_close(clean[normal], left[normal][:, :, own].sum(2) / 6, atol=1e-6, rtol=0)
    torch.testing.assert_close(coverage[normal], torch.full_like(coverage[normal], 5 / 6))


@pytest.mark.parametrize("choice", range(7))
def test_every_candidate_can_be_chosen(choice):
    made, given = evenly(), inputs()
    bias = made.leave[2].bias.data.view(-1, 4)  # the four pixels of a square
    bias[choice] = 100.0
    bias[7:10] = torch.tensor([0.1, 0.2, 0.3])[:, None]
    clean, coverage = run(made, given)
    velocity = torch.tensor([0.1, 0.2, 0.3])[:, None, None].expand(3, SIZE, SIZE)
    painted = -levels(given["time"])[1] * velocity
    if choice == 6:  # the background
        assert clean.abs().max() < 1e-30
        assert not coverage.any()
    else:
        expected = candidates(given)[:, :, choice] + (painted if choice == 5 else 0)
        torch.testing.assert_close(clean, expected, atol=1e-5, rtol=0)
        assert (coverage == 1).all()


def test_light_makes_copied_colours_brighter_and_leaves_normals():
    made, given = evenly(), inputs()
    bias = made.leave[2].bias.data.view(-1, 4)
    bias[1], bias[10] = 100.0, 0.4  # the nearest colour, brighter
    clean, _ = run(made, given)
    normal = given["flags"][:, DOMAIN] == 1
    assert 0 < normal.sum() < len(normal)
    copy = candidates(given)[:, :, 1]
    torch.testing.assert_close(clean[~normal], (copy[~normal] + 1) * np.exp(0.4) - 1, atol=1e-5, rtol=0)
    torch.testing.assert_close(clean[normal], copy[normal], atol=1e-5, rtol=0)


def test_hidden_picture_leaves_no_trace_of_its_colours():
    hidden = inputs(conditioned=0.0)
    hidden["flags"][:, DOMAIN] = 0
    other = hidden | {name: torch.rand_like(hidden[name]) for name in ("image", "carried")}
    other["alpha"] = torch.cat([hidden["alpha"][:, :VIEWS], torch.rand_like(hidden["alpha"][:, VIEWS:])], 1)
    for a, b in zip(run(network(), hidden), run(network(), other), strict=True):
        assert torch.equal(a, b)


def test_shown_picture_and_everything_else_matter():
    given = {name: value.requires_grad_() for name, value in inputs().items()}
    for value in network()(**given):
        gradients = torch.autograd.grad(value[:, :, 0].sin().sum(), list(given.values()), retain_graph=True)
        assert all(gradient.abs().max() > 0 for gradient in gradients)
        for flag in (DOMAIN, ALPHA_KNOWN):
            assert gradients[-1][:, flag].abs().max() > 0


def test_samples_do_not_see_each_other():
    given, other = inputs(3), inputs(3, seed=1)
    mixed = {name: torch.cat([given[name][:1], other[name][1:]]) for name in given}
    for a, b in zip(run(network(), given), run(network(), mixed), strict=True):
        assert torch.equal(a[0], b[0])
        assert not torch.equal(a[1], b[1])


def test_views_have_no_order():
    given, order = inputs(), [2, 0, 3, 1]
    turned = given | {name: given[name][:, order] for name in ("noisy", "carried")}
    turned |= {name: given[name][:, [*order, VIEWS]] for name in ("alpha", "geometry")}
    for a, b in zip(run(network(), given), run(network(), turned), strict=True):
        torch.testing.assert_close(a[:, order], b, atol=1e-5, rtol=0)


def test_views_see_each_other_and_the_picture():
    made, given = network(), inputs(1)
    for name, view in (("noisy", 1), ("geometry", VIEWS)):
        value = given[name].clone().requires_grad_()
        made(**(given | {name: value}))[1][0, 0].sum().backward()
        assert value.grad[0, view].abs().max() > 0


def test_every_parameter_gets_a_gradient():
    made = network()
    clean, coverage = made(**inputs())
    (clean.square().sum() + coverage.square().sum()).backward()
    # A bias of the keys adds the same to all scores of a query.
    without = {name for name, p in made.named_parameters() if p.grad.abs().max() <= 1e-7}
    assert without <= {"key.bias"}


def test_shipped_size_is_as_the_configuration_says():
    made = PriorNetwork(settings(PriorNetworkSettings, conf("train", "prior")["network"]))
    assert round(sum(value.numel() for value in made.parameters()) / 1e6, 2) == 2.23


@pytest.mark.parametrize("widths", [(12, 16, 16), (8, 24, 16), (8, 16, 24)])
def test_impossible_widths(widths):
    with pytest.raises(ConfigError, match="widths"):
        dataclasses.replace(SETTINGS, widths=widths, head=16)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("prior") / "prior.onnx"
    export(network(), signature(SIZE), SIZE, path, {"name": "prior"})
    return path


@pytest.mark.parametrize("conditioned", [0.0, 1.0])
@pytest.mark.parametrize("count", [1, 2])
def test_file_equals_the_network_with_rounded_weights(exported, count, conditioned):
    rounded = network()
    for value in rounded.state_dict().values():
        value.copy_(value.half().float())
    given = inputs(count, seed=5, conditioned=conditioned)
    got = session(exported, 1, signature(SIZE)).run(None, {name: value.numpy() for name, value in given.items()})
    for expected, value in zip(run(rounded, given), got, strict=True):
        assert np.abs(expected.numpy() - value).max() < 1e-4


def test_comparison_sees_another_network(exported):
    assert read_json(exported.parent / "records/prior.onnx.json")["difference_to_torch"] < 1e-4
    assert difference(network(seed=1), signature(SIZE), exported, SIZE) > 1e-2


def test_loader_refuses_another_signature_by_name(exported):
    with pytest.raises(ModelFileError, match="other inputs") as caught:
        session(exported, 1, signature(24))
    assert "carried (free, 4, 13, 24, 24)" in caught.value.expected
    assert f"carried (batch, 4, 13, {SIZE}, {SIZE}) float" in caught.value.got
    right = signature(SIZE)
    renamed = {"picture" if name == "image" else name: shape for name, shape in right.inputs.items()}
    with pytest.raises(ModelFileError, match="other inputs") as caught:
        session(exported, 1, dataclasses.replace(right, inputs=renamed))
    assert "picture" in caught.value.expected
