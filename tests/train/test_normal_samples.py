"""Samples of the normal network: seeded, in the convention, and as wrong as asked for."""

import dataclasses
import pickle

import numpy as np
import pytest
import torch

from soar.body.lbs import pose_vertices
from soar.config import settings
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.normal_inputs import INPUTS, OUTPUTS, covered
from soar.perception.normals import sign_test
from soar.synthetic.settings import SyntheticSettings
from soar.train.normal_samples import NormalSamples, NormalSampleSettings, planes, wrong_body
from tests.conftest import conf, model_file

SETTINGS = dataclasses.replace(
    settings(NormalSampleSettings, conf("train", "normals")["samples"]), sizes=((64, 48), (32, 32)), pixels=3 * 64 * 48
)
WHOLE = dataclasses.replace(SETTINGS, view=dataclasses.replace(SETTINGS.view, half=0.0))


@pytest.fixture(scope="module")
def samples() -> NormalSamples:
    models = model_file("body/anny_helpers.npz").parents[1]
    return NormalSamples(WHOLE, settings(SyntheticSettings, conf("synthetic", "default")), models)


def test_batches_are_a_function_of_their_number(samples):
    again = pickle.loads(pickle.dumps(samples))
    assert "people" not in again.__dict__
    first, second = samples.batch("train", 3), again.batch("train", 3)
    for a, b in zip(first, second, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    for other in (samples.batch("train", 4), samples.batch("validate", 3)):
        assert other[0]["image"].shape != first[0]["image"].shape or not np.array_equal(
            other[0]["image"], first[0]["image"]
        )


def test_batches_have_one_size_and_fill_the_pixels(samples):
    sizes = set()
    for index in range(6):
        made = samples.batch("train", index)
        shapes = {sample["image"].shape for sample in made}
        assert len(shapes) == 1
        _, height, width = shapes.pop()
        sizes.add((height, width))
        assert len(made) == WHOLE.pixels // (height * width)
    assert sizes == set(WHOLE.sizes)


def test_planes_and_ranges(samples):
    for sample in samples.batch("train", 0):
        height, width = sample["image"].shape[1:]
        expected = INPUTS | OUTPUTS | {"weight": 1}
        assert {name: value.shape for name, value in sample.items()} == {
            name: (count, height, width) for name, count in expected.items()
        }
        known = sample["weight"][0] > 0
        assert known.sum() > 50
        for name in OUTPUTS:
            np.testing.assert_allclose(np.linalg.norm(sample[name][:, known], axis=0), 1, atol=1e-4)


def test_truth_and_body_are_in_the_convention(samples):
    for seed in range(4):
        sample = samples.sample(np.random.default_rng(seed), "train", 96, 80, 0.0)
        for front, back in ((sample.front, sample.back), (sample.body_front, sample.body_back)):
            found = sign_test(front, back)
            assert found.facing < 0 < found.behind
            assert found.left < found.right
            assert found.top < found.bottom


def test_amount_moves_the_body_and_nothing_else(samples):
    true, off, twice = (
        samples.sample(np.random.default_rng(1), "benchmark", 96, 80, amount) for amount in (0.0, 1.0, 2.0)
    )
    for name in ("rgb", "mask", "front", "back", "alpha"):
        assert np.array_equal(getattr(true, name), getattr(twice, name))
    assert true.outfit == twice.outfit

    def angle(sample):
        both = covered(sample.body_front) & covered(true.body_front)
        cosine = (sample.body_front * true.body_front).sum(-1)[both]
        return np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).mean()

    assert angle(true) < 0.1
    assert 2 < angle(off) < angle(twice)


def test_wrong_body_of_nothing_is_the_true_one(samples):
    people = samples.people
    subject = people.subject("train", 2)
    pose, body = people.pose(subject), people.wardrobe.body
    args = (body, subject.betas, pose, WHOLE.body)
    expected = pose_vertices(
        body,
        torch.from_numpy(subject.betas),
        axis_angle_to_matrix(torch.from_numpy(pose.pose)),
        torch.from_numpy(pose.translation),
    )
    still = wrong_body(np.random.default_rng(0), *args, 0.0)
    torch.testing.assert_close(still, expected)
    moved = [(wrong_body(np.random.default_rng(0), *args, a) - still).norm(dim=1).mean() for a in (1.0, 2.0)]
    assert 0.005 < moved[0] < 0.1
    assert float(moved[1] / moved[0]) == pytest.approx(2, rel=0.1)


def test_known_pixels_are_the_persons_and_the_masks(samples):
    sample = samples.sample(np.random.default_rng(2), "train", 64, 48, 1.0)
    lost = dataclasses.replace(sample, mask=sample.mask * 0)
    assert sample.known.any()
    assert not lost.known.any()
    assert (sample.alpha[sample.known] > 0.5).all()
    assert np.array_equal(planes(sample)["weight"][0] > 0, sample.known)
