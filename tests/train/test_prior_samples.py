"""Samples of the prior: seeded, as often hidden, blind or normal as asked for, and mirrored as the world would be."""

import dataclasses
import functools
import pickle
import types

import numpy as np
import pytest

from soar.config import settings
from soar.networks.prior_inputs import (
    BODY,
    DOMAIN,
    NORMAL,
    PLACE,
    REACH,
    VIEWS,
    carried,
    carried_normals,
    signature,
)
from soar.synthetic.settings import SyntheticSettings
from soar.train.prior_samples import PriorSamples, PriorSampleSettings, inputs, mirrored, shifted
from tests.conftest import conf, model_file

SIZE = 32
REACH_PX = round(REACH * SIZE)
SETTINGS = dataclasses.replace(settings(PriorSampleSettings, conf("train", "prior")["samples"]), size=SIZE, count=2)


@pytest.fixture(scope="module")
def samples() -> PriorSamples:
    models = model_file("body/anny_helpers.npz").parents[1]
    return PriorSamples(SETTINGS, settings(SyntheticSettings, conf("synthetic", "default")), models)


@pytest.fixture(scope="module")
def front(samples):
    return samples.turntable(3, "benchmark", picture=0, first=0)


def drawn(samples, seed=0, **changes):
    """A sample with some settings changed, of the same people."""
    other = PriorSamples(dataclasses.replace(SETTINGS, **changes), samples.synthetic, samples.models)
    other.__dict__["people"] = samples.people
    return other.sample(np.random.default_rng(seed))


def test_batches_are_a_function_of_their_number(samples):
    first = samples.batch("train", 3)
    again = pickle.loads(pickle.dumps(samples))
    assert "people" not in again.__dict__
    again.__dict__["people"] = samples.people
    for name, value in again.batch("train", 3).items():
        assert np.array_equal(first[name], value), name
    for other in (samples.batch("train", 4), samples.batch("validate", 3)):
        assert not np.array_equal(other["geometry"], first["geometry"])
        assert not np.array_equal(other["noise"], first["noise"])


def test_shapes_are_the_signatures(samples):
    made = samples.batch("train", 0)
    expected = {name: shape[1:] for name, shape in signature(SIZE).inputs.items() if name != "noisy"}
    expected |= {"target": (VIEWS, 3, SIZE, SIZE), "coverage": (VIEWS, 1, SIZE, SIZE), "noise": (VIEWS, 3, SIZE, SIZE)}
    assert {name: value.shape[1:] for name, value in made.items()} == expected
    assert all(len(value) == 2 and value.dtype == np.float32 for value in made.values())


def test_turntable_is_seen_from_where_it_says(samples, front):
    """The first view of a turntable at the front is the picture; the third sees the back, those between the sides."""
    body = front.body
    assert np.array_equal(body[0], body[VIEWS])
    assert np.array_equal(front.pictures("colour")[0], front.pictures("colour")[VIEWS])
    depth, left = samples.people.wardrobe.body.front.numpy(), samples.people.wardrobe.body.left.numpy()
    for view, axis in ((0, depth), (1, left), (2, -depth), (3, -left)):
        on = body[view][BODY][0] > 0.5
        # What is seen lies on the side of the mean body that faces the camera, and faces it.
        toward = np.einsum("p,pn->n", axis, body[view][PLACE][:, on] - body[:VIEWS, PLACE].mean((0, 2, 3))[:, None])
        assert np.median(toward) > 0.03
        assert (body[view][NORMAL][2][on] < 0).mean() > 0.98


def test_pictures_are_laid_over_grey(front):
    colour, normal, alpha = front.pictures("colour"), front.pictures("normal"), front.alpha
    assert colour.shape == normal.shape == (VIEWS + 1, 3, SIZE, SIZE)
    assert not (colour * (alpha == 0)).any()
    assert (np.abs(colour) <= alpha + 1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), alpha[:, 0], atol=1e-4)
    inner = alpha[2, 0] == 1
    np.testing.assert_allclose(colour[2][:, inner], 2 * front.maps[2].colour.numpy()[:, inner] - 1)


@pytest.mark.parametrize("domain", ["colour", "normal"])
def test_domains(front, domain):
    made = inputs(front, domain, alpha_known=True)
    assert made["flags"][DOMAIN] == (domain == "normal")
    assert np.array_equal(made["image"], front.pictures(domain)[VIEWS])
    picture, alpha, body = front.pictures("colour")[VIEWS], front.alpha[VIEWS, 0], front.body
    colours = carried(picture, alpha, body[VIEWS], body[:VIEWS], REACH_PX)
    assert np.array_equal(made["carried"], colours if domain == "colour" else carried_normals(body[:VIEWS], REACH_PX))


def test_alpha_is_the_persons_or_the_bodys(front):
    for known, alpha in ((True, front.alpha[:VIEWS]), (False, front.body[:VIEWS, BODY])):
        made = inputs(front, "colour", alpha_known=known)
        assert made["flags"].tolist() == [0, 1, known]
        assert np.array_equal(made["alpha"][:VIEWS], alpha)
        assert np.array_equal(made["alpha"][VIEWS], front.alpha[VIEWS])
    assert np.abs(front.alpha[:VIEWS] - front.body[:VIEWS, BODY]).max() > 0.5


def test_shares_of_everything_at_their_ends(samples):
    always = drawn(samples, normals=1.0, dropped=1.0, alpha_known=1.0, blind=1.0, misplaced=0.0)
    assert always["flags"].tolist() == [1, 0, 1]
    assert always["time"] == 1
    assert np.array_equal(always["alpha"][:VIEWS], always["coverage"])
    lengths = np.linalg.norm(always["target"], axis=1)
    np.testing.assert_allclose(lengths, always["coverage"][:, 0], atol=1e-4)
    never = drawn(samples, normals=0.0, dropped=0.0, alpha_known=0.0, blind=0.0)
    assert never["flags"].tolist() == [0, 1, 0]
    assert 0.02 <= never["time"] < 1
    assert np.array_equal(never["alpha"][:VIEWS], never["geometry"][:VIEWS, BODY])


def test_shifting_moves_the_geometry_and_nothing_else(front):
    moved = shifted(front, np.random.default_rng(0), 2.0)
    assert moved.maps is front.maps
    moves = []
    for before, after in zip(front.body, moved.body, strict=True):
        fits = [
            (y, x) for y in range(-2, 3) for x in range(-2, 3) if np.array_equal(np.roll(before, (y, x), (1, 2)), after)
        ]
        assert len(fits) == 1
        moves += fits
    assert len(set(moves)) > 2
    assert np.array_equal(shifted(front, np.random.default_rng(0), 0.0).body, front.body)
    full = dataclasses.replace(front, body=np.ones_like(front.body))
    bands = shifted(full, np.random.default_rng(0), 2.0).body[:, 0]
    assert [int(band.sum()) for band in bands] == [(SIZE - abs(y)) * (SIZE - abs(x)) for y, x in moves]


def whole(turntable, domain):
    """A sample without chance that carries nothing beyond the outline, where two pixels may be equally near, and in
    place of the clothed normals wants the body's."""
    made = inputs(turntable, domain, alpha_known=True)
    source, views = turntable.body[VIEWS], turntable.body[:VIEWS]
    alpha = turntable.alpha[VIEWS, 0]
    made["carried"] = (
        carried_normals(views, 0) if domain == "normal" else carried(made["image"], alpha, source, views, 0)
    )
    target = made["geometry"][:VIEWS, NORMAL] if domain == "normal" else turntable.pictures(domain)[:VIEWS]
    noise = np.random.default_rng(0).standard_normal(target.shape, np.float32)
    return made | {"target": target, "coverage": turntable.alpha[:VIEWS], "noise": noise, "time": np.float32(0.3)}


@pytest.mark.parametrize("domain", ["colour", "normal"])
def test_mirroring_the_inputs_is_carrying_in_the_mirrored_world(front, domain):
    made = whole(front, domain)
    got = mirrored(made)
    geometry, alpha = got["geometry"], front.alpha[VIEWS, 0, :, ::-1]
    if domain == "normal":
        expected = carried_normals(geometry[:VIEWS], 0)
        assert np.array_equal(got["target"], geometry[:VIEWS, NORMAL])
        assert np.array_equal(got["noise"][0, 0], -made["noise"][3, 0, :, ::-1])
    else:
        expected = carried(got["image"], alpha, geometry[VIEWS], geometry[:VIEWS], 0)
        assert np.array_equal(got["target"], front.pictures(domain)[:VIEWS][::-1, ..., ::-1])
    np.testing.assert_allclose(got["carried"], expected, atol=1e-6)
    assert np.array_equal(got["alpha"][:VIEWS], got["coverage"])
    assert got["time"] == made["time"]
    assert np.array_equal(got["flags"], made["flags"])
    assert all(np.array_equal(value, made[name]) for name, value in mirrored(got).items())


def test_mirrored_sample_is_what_cameras_on_the_other_side_see(samples):
    """A body that is its own mirror image, at rest: order of the views, signs of places and normals."""
    people = samples.people
    subject = people.subject("benchmark", 3)
    still = people.renderer.pose(
        people.renderer.dress(subject), np.zeros_like(people.pose(subject).pose), np.zeros(3), people.light(subject)
    )
    other = PriorSamples(SETTINGS, samples.synthetic, samples.models)
    other.__dict__["people"] = types.SimpleNamespace(
        posed=lambda family, seed: still, framed=people.framed, renderer=people.renderer
    )
    look = functools.partial(other.turntable, 0, "benchmark")
    got = mirrored(whole(look(picture=20, first=35), "colour"))["geometry"]
    expected = look(picture=-20, first=55).body
    assert np.mean(np.abs(got[:, BODY] - expected[:, BODY]) < 0.3) > 0.995
    both = (got[:, BODY] == 1) & (expected[:, BODY] == 1)
    for planes in (PLACE, NORMAL):
        error = np.linalg.norm(got[:, planes] - expected[:, planes], axis=1)[both[:, 0]]
        assert np.quantile(error, 0.95) < 0.05, planes
