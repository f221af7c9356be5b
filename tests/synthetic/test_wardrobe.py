"""The static record: sizes shared with the native library, attributes, and the helper geometry of the export."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from soar.body import lbs
from soar.errors import ModelFileError
from soar.geometry.meshes import vertex_normals
from soar.synthetic import native
from soar.synthetic.garments import NOT_WORN
from soar.synthetic.records import pack
from soar.synthetic.scene import People
from soar.synthetic.wardrobe import Helpers
from tests.conftest import model_file


def test_records_are_as_long_as_the_native_structs(people: People) -> None:
    sizes = native.record_sizes(native.people())
    records = (
        people.wardrobe.anchors,
        people.subject("train", 0).person,
        NOT_WORN,
        people.light(people.subject("train", 0)),
    )
    assert [len(pack(record)) for record in records] == sizes[: len(native.RECORDS)]


def test_anchors_lie_in_order_up_the_body(people: People) -> None:
    a = people.wardrobe.anchors
    heights = [
        a.ground,
        a.ankle,
        a.knee,
        a.crotch,
        a.waist,
        a.chest,
        a.shoulder,
        a.neck,
        a.chin,
        a.lip[2],
        a.eye[2],
        a.crown,
    ]
    assert heights == sorted(heights)
    assert 0.02 < a.eye[0] < 0.05
    assert all(x > 0 for x, _ in (*a.brow, *a.lid_upper, *a.lid_lower))
    assert a.brow[2][1] > a.lid_upper[2][1] > a.lid_lower[2][1]


def test_sky_is_open_on_the_crown_and_narrow_under_the_chin(people: People) -> None:
    attributes = people.wardrobe.attributes[people.wardrobe.group_slices["body"]]
    sky, place = attributes[:, 7], attributes[:, :3]
    assert sky.min() >= 0
    assert sky.max() <= 1
    assert sky[place[:, 2].argmax()] > 0.85
    anchors = people.wardrobe.anchors
    throat = np.abs(place - [0.0, anchors.lip[1] + 0.06, anchors.chin - 0.015]).max(1) < 0.025
    assert throat.sum() > 10
    assert sky[throat].mean() < 0.8


def test_helpers_surround_the_body_in_every_shape(people: People) -> None:
    body, helpers = people.wardrobe.body, Helpers.load(model_file("body/anny_helpers.npz"))
    rng = np.random.default_rng(0)
    for betas in (np.zeros(10), *rng.normal(size=(3, 10))):
        skin = lbs.rest_vertices(body, torch.from_numpy(betas).float())
        normals = vertex_normals(skin, body.faces)[helpers.nearest].numpy()
        points = helpers.v_template + helpers.shapedirs.astype(np.float32) @ betas
        outside = ((points - skin[helpers.nearest].numpy()) * normals).sum(1)
        suit = np.unique(helpers.tights)
        assert np.median(outside[suit]) > 0.002
        assert (outside[suit] > -0.01).mean() > 0.97
    np.testing.assert_allclose(helpers.weights.sum(1), 1, atol=1e-5)


def test_a_missing_file_is_named_with_its_cure(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"anny_helpers\.npz") as caught:
        Helpers.load(tmp_path / "anny_helpers.npz")
    assert "models fetch" in caught.value.cure
