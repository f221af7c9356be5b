"""The prior's provider: guidance is the formula, and files that are not what they should be are refused."""

import shutil

import numpy as np
import pytest

from soar.errors import ModelFileError
from soar.networks.export import export
from soar.networks.prior_inputs import CONDITIONED, VIEWS, signature
from soar.priors.mini import MiniPrior
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
