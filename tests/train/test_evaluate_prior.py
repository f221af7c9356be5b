"""Figures of the prior on pictures made by hand: what is compared, where, and against which colours."""

import dataclasses
import math
import types

import numpy as np
import pytest
import torch

from soar.body.record import BodyModel
from soar.networks.prior_inputs import BODY, PLACE, VIEWS
from soar.synthetic.garments import NOT_WORN
from soar.synthetic.records import LAYERS, PrintKind
from soar.train.evaluate_prior import (
    BACK,
    SIDES,
    Parts,
    PriorEvaluationSettings,
    Truth,
    methods,
    part_means,
    plain,
    table,
)
from soar.train.prior_samples import Turntable
from tests.conftest import model_file

SIZE = 8
HEAD, TORSO, FOOT = (np.array([0.1, 0.0, z], np.float32) for z in (0.8, 0.0, -0.8))
PARTS = Parts(np.stack([TORSO, HEAD, FOOT]), np.array([1, 0, 2]))
RED, GREEN, BLUE = ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))


class Difference:
    """In place of LPIPS: the mean absolute difference of each pixel."""

    def features(self, images):
        return [images]

    def spatial(self, a, b, size):
        return (a[0] - b[0]).abs().mean(1, keepdim=True)


def view(head, torso, foot):
    """Maps of four rows: head, torso, foot, nothing; the right half is nothing either."""
    half = SIZE // 2
    colour, place = torch.zeros(3, SIZE, SIZE), torch.zeros(3, SIZE, SIZE)
    alpha, layer = torch.zeros(SIZE, SIZE), torch.full((SIZE, SIZE), -1, dtype=torch.int32)
    for row, (paint, where) in enumerate(((head, HEAD), (torso, TORSO), (foot, FOOT))):
        rows = slice(2 * row, 2 * row + 2)
        if paint is not None:
            colour[:, rows, :half] = torch.tensor(paint)[:, None, None]
            place[:, rows, :half] = torch.from_numpy(where)[:, None, None]
            alpha[rows, :half], layer[rows, :half] = 1, 0
    layer[2:6] = torch.where(layer[2:6] == 0, LAYERS.index("top"), layer[2:6])
    return types.SimpleNamespace(colour=colour, alpha=alpha, layer=layer, place=place)


def turntable(picture, *views):
    maps = [view(*colours) for colours in (*views, picture)]
    body = np.zeros((VIEWS + 1, 7, SIZE, SIZE), np.float32)
    for planes, one in zip(body, maps, strict=True):
        planes[PLACE], planes[BODY] = one.place, one.alpha
    return Turntable(tuple(maps), (), None, body)


ALL = turntable((RED, GREEN, BLUE), *[(RED, GREEN, BLUE)] * 4)


def test_parts_of_the_body():
    body = BodyModel.load(model_file("body/anny.npz"))
    parts = Parts.of(body)
    assert sorted(set(parts.labels)) == list(range(16))  # six of the ten are left and right
    left, height = body.left.numpy(), parts.places @ body.up.numpy()
    assert height[parts.labels == 0].min() > np.quantile(height, 0.5)
    highest = height.max()
    assert parts.labels[height > highest - 0.1].tolist() == [0] * int((height > highest - 0.1).sum())
    sides = [np.median(parts.places[parts.labels == label] @ left) for label in range(16)]
    assert sum(side > 0.03 for side in sides) == sum(side < -0.03 for side in sides) == 6


def test_map_of_parts():
    label = PARTS.map(ALL.body[0])
    assert label[:, 0].tolist() == [0, 0, 1, 1, 2, 2, -1, -1]
    assert (label[:, SIZE // 2 :] == -1).all()


def test_part_means_fill_everything():
    got = part_means(ALL, PARTS)
    assert got.shape == (VIEWS, 3, SIZE, SIZE)
    expected = 2 * np.array([RED, GREEN, BLUE]).repeat(2, 0).T - 1
    for column in (0, SIZE // 2 - 1):
        np.testing.assert_allclose(got[1, :, :6, column], expected, atol=1e-6)
    np.testing.assert_allclose(got[0, :, 7, 0], expected[:, -1], atol=1e-6)  # beyond the foot
    np.testing.assert_allclose(got[0, :, 2, SIZE - 1], expected[:, 2], atol=1e-6)  # beside the torso


def test_unseen_parts_have_the_mean_of_all():
    made = turntable((RED, GREEN, None), *[(RED, GREEN, BLUE)] * 4)
    got = part_means(made, PARTS)
    np.testing.assert_allclose(got[2, :, 4, 0], [0, 0, -1], atol=1e-6)


def test_figures_of_known_errors():
    made = turntable((RED, GREEN, BLUE), (RED, GREEN, BLUE), (RED, None, BLUE), (RED, GREEN, BLUE), (None, GREEN, BLUE))
    images = made.pictures("colour")[:VIEWS] / 2  # 1 becomes 0.75 and 0 becomes 0.25 of [0, 1]
    images[0] = 5.0  # the front is not judged
    images[..., SIZE // 2 :] = 7.0  # nor what is not the person's
    got = Truth(made, PARTS, Difference()).figures(images)
    for name in ("back", "side"):
        assert got[f"{name}_db"] == pytest.approx(-20 * math.log10(0.25), abs=1e-4)
        assert got[f"{name}_lpips"] == pytest.approx(0.25, abs=1e-6)
    assert got["head_db"] == pytest.approx(-20 * math.log10(0.25), abs=1e-4)
    worse = images.copy()
    worse[BACK, :, :2] = 0.0  # the head from behind
    assert Truth(made, PARTS, Difference()).figures(worse)["head_db"] == pytest.approx(-20 * math.log10(0.5), abs=1e-4)
    worse = images.copy()
    worse[SIDES[1]] = 0.0
    other = Truth(made, PARTS, Difference()).figures(worse)
    assert other["back_db"] == pytest.approx(got["back_db"])
    assert other["side_db"] == pytest.approx(-10 * math.log10(0.25 * 0.5), abs=1e-4)  # the mean of both in dB


def test_hair_and_hats_count_as_head_and_a_view_without_has_no_figure():
    made = turntable((RED, GREEN, BLUE), *[(None, GREEN, BLUE)] * 4)
    images = made.pictures("colour")[:VIEWS]
    assert math.isnan(Truth(made, PARTS, Difference()).figures(images)["head_db"])
    made.maps[BACK].layer[2, :2] = LAYERS.index("long_hair")
    made.maps[BACK].alpha[2, 1] = 0.5
    images = made.pictures("colour")[:VIEWS]
    images[BACK, :, 2, 0] = 0.0
    expected = -10 * math.log10(0.5**2 / 1.5)  # the other pixel is right and counts by its alpha
    assert Truth(made, PARTS, Difference()).figures(images)["head_db"] == pytest.approx(expected, abs=1e-4)


class Oracle:
    """A prior that knows the answer; keeps what it was asked."""

    size = SIZE

    def __init__(self, truth):
        self.truth, self.asked = truth, []

    def __call__(self, noisy, time, given, guidance):
        self.asked.append((noisy, time, given, guidance))
        return self.truth, None


def test_methods_ask_the_prior_what_their_names_say():
    truth = ALL.pictures("colour")[:VIEWS]
    prior, noise = Oracle(truth), np.ones((VIEWS, 3, SIZE, SIZE), np.float32)
    options = PriorEvaluationSettings(0, 1, (0.5,), (1.3,), 4)
    known = methods(prior, PARTS, options)
    for name, method in known.items():
        got = method(ALL, noise)
        # With all views alike every method is right, also outside the person.
        np.testing.assert_allclose(got, truth, atol=1e-5, err_msg=name)
    times, scales = ([call[index] for call in prior.asked] for index in (1, 3))
    assert times == [1.0, 0.5, 0.5, 1.0, 0.75, 0.5, 0.25]
    assert scales == [1.0, 1.0, 0.0, 1.3, 1.3, 1.3, 1.3]
    np.testing.assert_allclose(prior.asked[0][0], noise, atol=1e-6)  # no trace of the truth
    np.testing.assert_allclose(prior.asked[1][0], (truth + noise) / 2**0.5, atol=1e-6)
    assert all(call[2]["flags"].tolist() == [0, 1, 1] for call in prior.asked)


def subject(**changes):
    worn = dataclasses.replace(NOT_WORN, worn=1.0, **changes)
    return types.SimpleNamespace(person=types.SimpleNamespace(clothes=(NOT_WORN, worn)))


def test_plain_clothes():
    printed = dataclasses.replace(NOT_WORN.chest, kind=PrintKind.STAR)
    other = dataclasses.replace(NOT_WORN.front, period=NOT_WORN.front.period + 1)
    assert plain(subject())
    for change in ({"chest": printed}, {"spine": printed}, {"back": other}, {"opening": 0.03}):
        assert not plain(subject(**change))
        unworn = dataclasses.replace(NOT_WORN, **change)
        assert plain(types.SimpleNamespace(person=types.SimpleNamespace(clothes=(unworn,))))


def test_table_of_means():
    rows = {"back_db": [10.0, 14.0], "back_lpips": [0.1, 0.2], "side_db": [20.0, 21.0], "side_lpips": [0.3, 0.3]}
    result = {"methods": {"mirrored": {**rows, "head_db": [float("nan"), 9.0]}}, "plain": [False, True]}
    first, _, row = table(result).splitlines()
    assert first.startswith("2 people, 1 in plain clothes")
    assert row.split() == ["mirrored", "12.00", "0.150", "20.50", "0.300", "14.00", "0.200", "9.00"]
    assert table(result | {"plain": [False, False]}).splitlines()[2].split()[5:7] == ["nan", "nan"]
