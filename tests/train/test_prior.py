"""The task `prior`: loss, what the perceptual part sees, a short training with its record, and its evaluation."""

import dataclasses
import functools
import math
import types

import numpy as np
import pytest
import torch
from torch import nn

from soar.artifacts import read_json
from soar.models.onnx import session
from soar.networks.prior_inputs import DOMAIN, VIEWS, signature
from soar.train.evaluate_prior import table
from soar.train.registry import task, training
from soar.workflow import composed
from tests.conftest import model_file
from tests.networks.small_prior import inputs


@functools.cache
def short(*overrides):
    """A configuration of moments."""
    return composed((
        "+train=prior", "train.steps=3", "train.minutes=null", "train.workers=0", "train.device=cpu",
        "train.record_every=1", "train.validate_every=3", "train.validation_batches=1",
        "train.network={widths: [8, 16, 16], depths: [1, 1, 1], embedding: 16, head: 8, pointer: 4}",
        "train.samples.size=32", "train.samples.count=2", "train.evaluation.count=2", "train.evaluation.times=[0.9]",
        "train.evaluation.guidance=[1.0, 1.3]", "train.evaluation.steps=2", *overrides,
    ))["train"]  # fmt: skip


@pytest.fixture(scope="module")
def models():
    return model_file("body/anny_helpers.npz").parents[1]


class Brightness(nn.Module):
    """In place of LPIPS: the difference of mean brightness; keeps what it was shown."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def forward(self, shown, truth):
        self.seen.append((shown, truth))
        return (shown.mean((1, 2, 3)) - truth.mean((1, 2, 3))).abs()


def loss_only(tmp_path, **changes):
    """A task without people, whose perceptual part is :class:`Brightness`."""
    made = task("prior", short(), tmp_path)
    made.settings = dataclasses.replace(made.settings, loss=dataclasses.replace(made.settings.loss, **changes))
    made._lpips = Brightness()
    return made


def batch(count=2, time=1.0):
    """Black pictures whose left half is covered by the person."""
    made = inputs(count) | {"time": torch.full((count,), time), "look": torch.full((count,), -1)}
    shape = (count, VIEWS, 3, 16, 16)
    coverage = torch.zeros(count, VIEWS, 1, 16, 16)
    coverage[..., :8] = 1
    return made | {"target": torch.full(shape, -1.0), "coverage": coverage, "noise": torch.ones(shape)}


def answer(error, coverage):
    """A network that is wrong by ``error`` everywhere."""

    def network(noisy, time, *given):
        assert [tuple(value.shape[1:]) for value in (noisy, time, *given)] == [
            shape[1:] for shape in signature(16).inputs.values()
        ]
        return torch.full_like(noisy, -1.0) + error, torch.full_like(noisy[:, :, :1], coverage)

    return network


def test_loss_of_known_pictures(tmp_path):
    made = loss_only(tmp_path, person=2.0, background=0.5, absolute=0.1, coverage=0.4, loudest=5.0)
    loss, figures = made.loss(answer(0.2, 0.25), batch())
    pixels, alpha = (0.04 + 0.1 * 0.2) * (2.0 + 0.5) / 2, (0.75**2 + 0.25**2) / 2
    assert float(loss) == pytest.approx(pixels + 0.4 * alpha, rel=1e-5)
    assert float(figures["db"]) == pytest.approx(-20 * math.log10(0.1), abs=1e-3)  # 0.2 of a range of 2
    assert figures["lpips"] == 0
    assert not made._lpips.seen


@pytest.mark.parametrize(("time", "weight"), [(1.0, 1.0), (0.5, 2.0), (0.02, 5.0)])
def test_samples_of_little_noise_count_more_up_to_a_bound(tmp_path, time, weight):
    made = loss_only(tmp_path, person=1.0, background=1.0, absolute=0.0, coverage=0.0, loudest=5.0)
    assert float(made.loss(answer(0.3, 0.5), batch(time=time))[0]) == pytest.approx(0.09 * weight, rel=1e-4)


def test_errors_of_the_background_do_not_count_in_the_figure(tmp_path):
    error = torch.zeros(16)
    error[8:] = 1.0
    assert float(loss_only(tmp_path).loss(answer(error, 0.5), batch())[1]["db"]) == pytest.approx(60, abs=1e-3)


def test_noisy_views_are_made_of_target_and_noise(tmp_path):
    def network(noisy, time, *given):
        torch.testing.assert_close(noisy, torch.zeros_like(noisy), atol=1e-6, rtol=0)  # -1 and 1, as loud as each other
        return noisy, noisy[:, :, :1]

    loss_only(tmp_path).loss(network, batch(time=0.5))


def test_perceptual_part_sees_the_chosen_views_alone(tmp_path):
    made, given = loss_only(tmp_path, perceptual=3.0), batch(4, 0.5)
    given["target"][2, 3] = 0.0
    error = torch.zeros(4, VIEWS, 1, 1, 1)
    error[2, 3], error[0, 1], error[1] = 0.5, 4.0, 9.0  # the second sample is not looked at
    plain, _ = made.loss(answer(error, 0.5), given)
    loss, figures = made.loss(answer(error, 0.5), given | {"look": torch.tensor([1, -1, 3, -1])})
    ((shown, truth),) = made._lpips.seen
    assert shown.shape == truth.shape == (2, 3, 16, 16)
    assert truth[:, 0, 0, 0].tolist() == [0, 0.5]
    assert shown[:, 0, 0, 0].tolist() == [1, 0.25]  # a range of [0, 1], clipped
    assert float(figures["lpips"]) == pytest.approx((1 + 0.25) / 2)
    assert float(loss - plain) == pytest.approx(3.0 * (1 + 0.25) / 4, rel=1e-4)


def test_perceptual_part_leaves_pure_noise_alone(tmp_path):
    """Its best guess is a mean of many answers; asking that to be sharp would cost error."""
    made = loss_only(tmp_path, perceptual=3.0)
    given = batch(2, 1.0) | {"look": torch.tensor([0, 1])}
    _, figures = made.loss(answer(0.5, 0.5), given)
    assert figures["lpips"] == 0
    assert not made._lpips.seen
    given["time"][1] = 0.98
    made.loss(answer(0.5, 0.5), given)
    assert [len(shown) for shown, _ in made._lpips.seen] == [1]


def test_views_to_look_at(tmp_path):
    """One view of half of the samples in the domain of colours."""
    made, flags = loss_only(tmp_path, looked_at=0.5), np.zeros((2000, 3), np.float32)
    flags[:1000, DOMAIN] = 1
    made.samples = types.SimpleNamespace(batch=lambda split, index: {"flags": flags})
    look = made.batch("train", 7)["look"]
    assert look.shape == (2000,)
    assert (look[:1000] == -1).all()
    counts = np.bincount(look[1000:] + 1, minlength=1 + VIEWS)
    assert abs(counts[0] - 500) < 60
    assert (abs(counts[1:] - 125) < 40).all()
    assert np.array_equal(made.batch("train", 7)["look"], look)
    assert not np.array_equal(made.batch("train", 8)["look"], look)
    assert not np.array_equal(made.batch("validate", 7)["look"], look)


def test_a_short_training_end_to_end(models, tmp_path, capsys):
    run = training("prior", short("train.loss.looked_at=1.0", "train.samples.normals=0.0"), models, tmp_path)
    run.run()
    session(tmp_path / "network.onnx", 1, signature(32))
    record = read_json(tmp_path / "records/network.onnx.json")
    assert record["name"] == "prior"
    assert record["training"]["steps"] == 3
    assert record["training"]["config"]["samples"]["size"] == 32
    assert record["inputs"]["carried"] == [None, 4, 13, 32, 32]
    assert {"loss", "db", "lpips"} <= set(record["validation"])
    assert all(0 < row["lpips"] < 1 and 5 < row["db"] < 30 for row in read_json(tmp_path / "curve.json"))
    assert (tmp_path / "sheet.jpg").stat().st_size > 0

    capsys.readouterr()
    run.task.evaluate(tmp_path / "network.onnx", tmp_path, 1)
    result = read_json(tmp_path / "evaluation.json")
    names = ["part mean", "mirrored", "nearest", "direct", "one step, t = 0.9", "unconditional, t = 0.9"]
    assert set(result["methods"]) == {*names, "sampled, g = 1", "sampled, g = 1.3"}
    assert len(result["plain"]) == 2
    for rows in result["methods"].values():
        assert set(rows) == {"back_db", "back_lpips", "side_db", "side_lpips", "head_db"}
        assert all(len(values) == 2 for values in rows.values())
        assert all(8 < value < 35 for value in rows["back_db"] + rows["side_db"])
        assert all(0 < value < 1 for value in rows["back_lpips"] + rows["side_lpips"])
    printed = capsys.readouterr().out.splitlines()
    assert sorted(printed) == sorted(table(result).splitlines())  # the file has the methods by the alphabet
    assert [line[:26].strip() for line in printed[2:8]] == names
