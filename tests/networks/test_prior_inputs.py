"""What the prior is given: every rule by which colours are carried, against its definition point by point."""

import numpy as np
import pytest

from soar.networks.prior_inputs import BODY, CARRIED, PLACE, RULES, VIEWS, carried, carried_normals, signature, spread
from tests.networks.small_prior import inputs


def scene(size=9, extent=1.0):
    """A picture, its alpha, its geometry and that of four views; about half of the pixels show the body."""
    rng = np.random.default_rng(0)
    geometry = rng.uniform(-1, 1, (VIEWS + 1, 7, size, size)).astype(np.float32)
    geometry[:, PLACE] *= extent
    geometry[:, 6] = rng.uniform(size=(VIEWS + 1, size, size)) < 0.5
    image = rng.uniform(-1, 1, (3, size, size)).astype(np.float32)
    seen = rng.uniform(size=(size, size)).astype(np.float32)
    return image, seen, geometry[VIEWS], geometry[:VIEWS]


def by_hand(image, seen, source, place):
    """The 13 numbers for one place, from the definitions of the rules."""
    points = [(source[PLACE, r, c], image[:, r, c]) for r, c in np.argwhere((source[6] > 0.5) & (seen > 0.5))]
    places, colours = (np.array(values, float) for values in zip(*points, strict=True))
    flat = np.linalg.norm((places - place) * [1, 0.12, 1], axis=1)
    straight = np.linalg.norm(places - place, axis=1)
    across = np.linalg.norm(places - place * np.array([-1, 1, 1]), axis=1)
    few = np.argsort(flat)[:12]
    weight = np.exp(-0.5 * (flat[few] / 0.05) ** 2 + 0.5 * (flat.min() / 0.05) ** 2)
    mean = (colours[few] * weight[:, None]).sum(0) / weight.sum()
    picked = [colours[flat.argmin()], colours[straight.argmin()], mean, colours[across.argmin()]]
    return np.concatenate([*picked, [min(straight.min() / 0.2, 1)]])


@pytest.mark.parametrize(("size", "extent"), [(9, 1.0), (9, 0.2), (3, 0.2)])  # 3: fewer points than the mean takes
def test_every_rule_against_its_definition(size, extent):
    image, seen, source, views = scene(size, extent)
    got = carried(image, seen, source, views, 0)
    assert got.shape == (VIEWS, CARRIED, size, size)
    assert got.dtype == np.float32
    on = views[:, BODY][:, 0] > 0.5
    for view, row, column in np.argwhere(on):
        expected = by_hand(image, seen, source, views[view, PLACE, row, column])
        np.testing.assert_allclose(got[view, :, row, column], expected, atol=1e-4)
    assert not np.moveaxis(got, 1, -1)[~on].any()
    assert 0 < got[:, -1][on].min() < got[:, -1][on].max() <= 1


def test_the_first_rule_mirrors_through_the_body_and_the_last_across_it():
    """Seen from the front: red on the left of the chest, green on the right. Wanted: the left of the back."""
    source = np.zeros((7, 1, 2), np.float32)
    source[PLACE, 0] = np.array([[0.1, -0.2, 0.3], [-0.1, -0.2, 0.3]]).T
    source[BODY] = 1
    image = np.array([[[1, 0]], [[0, 1]], [[0, 0]]], np.float32)
    back = source[None, :, :, :1].copy()
    back[:, 1] = 0.2
    got = carried(image, np.ones((1, 2)), source, np.pad(back, [(0, 0)] * 3 + [(0, 1)]), 0)[0, :, 0, 0]
    assert got[:3].tolist() == [1, 0, 0]
    assert got[9:12].tolist() == [0, 1, 0]
    assert got[12] == 1  # 40 cm away


def test_one_seen_point_colours_everything():
    image, seen, source, views = scene()
    seen = np.zeros_like(seen)
    seen[tuple(np.argwhere(source[6] > 0)[0])] = 1
    got = np.moveaxis(carried(image, seen, source, views, 0), 1, -1)[views[:, 6] > 0.5]
    colour = image[:, seen > 0][:, 0]
    np.testing.assert_allclose(got[:, : 3 * RULES], np.tile(colour, (len(got), RULES)), rtol=1e-6)


def test_nothing_seen_and_nothing_shown_give_nothing():
    image, seen, source, views = scene()
    assert not carried(image, seen * 0, source, views, 3).any()
    assert not carried(image, seen, source * 0, views, 3).any()
    assert not carried(image, seen, source, views * 0, 3).any()
    some = views.copy()
    some[1] = 0
    got = carried(image, seen, source, some, 3)
    assert not got[1].any()
    assert np.array_equal(got[2], carried(image, seen, source, views, 3)[2])


def test_reach_is_filled_from_the_nearest_pixel():
    planes = np.zeros((9, 9, 2), np.float32)
    known = np.zeros((9, 9), bool)
    known[4, 2], known[4, 7] = True, True
    planes[4, 2], planes[4, 7] = (1, 2), (3, 4)
    got = spread(planes, known, 2)
    expected = np.zeros_like(planes)
    expected[2:7, 0:5], expected[2:7, 5:9] = (1, 2), (3, 4)
    assert np.array_equal(got, expected)
    assert np.array_equal(spread(planes, known, 0), planes)
    assert not spread(planes * 0, known & False, 5).any()
    image, seen, source, views = scene()
    assert carried(image, seen, source, views, 9)[:, 0].all()


def test_normals_are_the_bodys_own():
    views = scene()[3]
    got = carried_normals(views, 0)
    assert got.shape == (VIEWS, CARRIED, 9, 9)
    assert got.dtype == np.float32
    for rule in range(RULES):
        assert np.array_equal(got[:, 3 * rule : 3 * rule + 3], views[:, 3:6] * (views[:, 6:] > 0.5))
    assert not got[:, 3 * RULES :].any()
    wide = carried_normals(views, 9)
    on = np.broadcast_to(views[:, 6:] > 0.5, got.shape)
    assert np.array_equal(wide[on], got[on])
    assert wide[:, : 3 * RULES].all()


def test_signature_has_the_shapes_that_the_functions_give():
    made = {name: value.shape[1:] for name, value in inputs(2, size=24).items()}
    assert made == {name: shape[1:] for name, shape in signature(24).inputs.items()}
    assert all(shape[0] is None for shape in signature(24).inputs.values())
    assert list(signature(24).inputs) == list(made)
