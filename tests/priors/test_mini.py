"""The prior's provider: guidance is the formula, and files that are not what they should be are refused."""

import shutil

import numpy as np
import pytest
import torch

from soar.errors import ModelFileError, NumericalError
from soar.networks.diffusion import levels
from soar.networks.export import export
from soar.networks.prior_inputs import CONDITIONED, VIEWS, assemble, signature
from soar.priors.mini import MiniPrior, MiniProvider
from soar.priors.protocol import Condition, Views
from tests.networks.small_prior import SIZE, inputs, network


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("prior") / "prior.onnx"
    export(network(), signature(SIZE), SIZE, path, {"name": "prior"})
    return path


@pytest.fixture(scope="module")
def prior(file):
    return MiniPrior(file, SIZE, 1)


def one():
    """Noisy views and the other inputs of one sample, without batch axis."""
    given = {name: value[0].numpy() for name, value in inputs(1).items()}
    return given.pop("noisy"), float(given.pop("time")), given


def alone(prior, conditioned):
    """What the network gives for one sample with the picture shown or hidden."""
    noisy, time, given = one()
    flags = given["flags"].copy()
    flags[CONDITIONED] = conditioned
    feed = given | {"noisy": noisy, "time": np.float32(time), "flags": flags}
    clean, coverage = prior.session.run(["clean", "coverage"], {name: value[None] for name, value in feed.items()})
    return clean[0], coverage[0]


def test_guidance_is_the_formula(prior):
    noisy, time, given = one()
    (shown, covered), (hidden, covered_hidden) = (alone(prior, conditioned) for conditioned in (1, 0))
    assert np.abs(shown - hidden).max() > 0.1
    for scale, expected, coverage in (
        (0.0, hidden, covered_hidden),
        (1.0, shown, covered),
        (1.3, hidden + 1.3 * (shown - hidden), covered),
        (0.5, (hidden + shown) / 2, covered),
    ):
        clean, got = prior(noisy, time, given, scale)
        assert clean.shape == (VIEWS, 3, SIZE, SIZE)
        assert got.shape == (VIEWS, 1, SIZE, SIZE)
        assert clean.dtype == np.float32
        np.testing.assert_allclose(clean, expected, atol=1e-5)
        np.testing.assert_allclose(got, coverage, atol=1e-5)


def test_inputs_stay_as_they_are_and_calls_repeat(prior):
    noisy, time, given = one()
    before = {name: value.copy() for name, value in given.items()}
    first, second = (prior(noisy, time, given, 2.0) for _ in range(2))
    assert all(np.array_equal(value, before[name]) for name, value in given.items())
    assert np.array_equal(first[0], second[0])
    without_flag = given | {"flags": np.where(np.arange(3) == CONDITIONED, 0, given["flags"]).astype(np.float32)}
    assert np.array_equal(prior(noisy, time, without_flag, 2.0)[0], first[0])  # guidance alone decides


def test_altered_missing_and_other_files_are_refused(file, tmp_path):
    shutil.copytree(file.parent, tmp_path, dirs_exist_ok=True)
    copied = tmp_path / file.name
    MiniPrior(copied, SIZE, 1)
    content = bytearray(copied.read_bytes())
    content[len(content) // 2] ^= 1
    copied.write_bytes(content)
    with pytest.raises(ModelFileError, match="not the file it should be"):
        MiniPrior(copied, SIZE, 1)
    with pytest.raises(ModelFileError, match="is missing"):
        MiniPrior(tmp_path / "none.onnx", SIZE, 1)
    with pytest.raises(ModelFileError, match="other inputs"):
        MiniPrior(file, 64, 1)


GUIDANCE, TIME = 1.3, 0.6


def scene(domain):
    """A condition and four views, in the protocol's terms, of the network's own small inputs."""
    given = {name: value[0] for name, value in inputs(1, seed=3).items()}
    alpha = given["alpha"]
    pictures = (0.5 + 0.5 * torch.cat([given["noisy"], given["image"][None]]).clamp(-1, 1)) * alpha
    condition = Condition(domain, pictures[VIEWS], alpha[VIEWS], given["geometry"][VIEWS], "says nothing to it")
    azimuth = torch.arange(4) * 90.0
    shown = pictures[:VIEWS].clone().requires_grad_()
    return condition, Views(shown, alpha[:VIEWS], given["geometry"][:VIEWS], azimuth, torch.zeros(4))


def seeded():
    return torch.Generator().manual_seed(5)


def by_hand(prior, condition, views):
    """The estimate (4, 3, S, S) in [-1, 1], by the network's own call."""
    pictures = 2 * views.pictures.detach() - views.alpha
    given = assemble(
        (2 * condition.picture - condition.alpha).numpy(),
        torch.cat([views.geometry, condition.geometry[None]]).numpy(),
        torch.cat([views.alpha, condition.alpha[None]]).numpy(),
        condition.domain == "normal",
        condition.domain == "colour",
    )
    level, noise = (value.item() for value in levels(torch.tensor([TIME])))
    noisy = level * pictures + noise * torch.randn(pictures.shape, generator=seeded())
    return torch.from_numpy(prior(noisy.numpy(), TIME, given, GUIDANCE)[0]).clamp(-1, 1)


@pytest.mark.parametrize("domain", ["colour", "normal"])
def test_provider_distils_before_grey_weighted_by_alpha(prior, domain):
    provider, (condition, views) = MiniProvider(prior, GUIDANCE), scene(domain)
    assert provider.size == SIZE
    (prompt,) = provider.prepare([condition])
    clean = by_hand(prior, condition, views)
    estimate = provider.estimate(prompt, views, TIME, seeded())
    torch.testing.assert_close(estimate, (clean + 1) / 2, atol=1e-5, rtol=0)
    loss = provider.loss(prompt, views, TIME, seeded())
    difference = 2 * views.pictures.detach() - views.alpha - clean
    torch.testing.assert_close(loss, 0.5 * (views.alpha * difference.square()).sum() / VIEWS, atol=0, rtol=1e-4)
    (gradient,) = torch.autograd.grad(loss, views.pictures)
    torch.testing.assert_close(gradient, 2 * views.alpha * difference / VIEWS, atol=1e-5, rtol=1e-4)


def test_provider_repeats_by_its_generator_and_sees_the_domain(prior):
    provider, (condition, views) = MiniProvider(prior, GUIDANCE), scene("colour")
    first, second = (provider.estimate(condition, views, TIME, seeded()) for _ in range(2))
    assert torch.equal(first, second)
    other, _ = scene("normal")
    assert not torch.allclose(first, provider.estimate(other, views, TIME, seeded()), atol=1e-3)


def test_provider_names_nan(prior, monkeypatch):
    provider, (condition, views) = MiniProvider(prior, GUIDANCE), scene("colour")
    broken = lambda *_: (np.full((VIEWS, 3, SIZE, SIZE), np.nan, np.float32), None)  # noqa: E731
    monkeypatch.setattr(provider, "prior", broken)
    with pytest.raises(NumericalError, match="NaN"):
        provider.loss(condition, views, TIME, seeded())
