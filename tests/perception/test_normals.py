"""Body normals on a sphere, and the sign test against every way to get the axes wrong."""

import numpy as np
import pytest
import torch

from soar.errors import ConfigError
from soar.perception.normals import encode, normal_provider, sign_test
from tests.conftest import conf
from tests.perception import normal_scenes
from tests.raster.scenes import VIEW, sphere


def maps(vertices, faces, node=None):
    crop = normal_scenes.crop(vertices=vertices, faces=faces)
    return normal_provider(node or conf("normals", "body"), normal_scenes.context([crop])).maps(crop)


def sphere_maps():
    return maps(*sphere())


def test_maps_are_the_surfaces_normals():
    front, back = sphere_maps()
    rows, columns = np.mgrid[:80, :96] + 0.5
    ray = np.stack([(columns - VIEW.cx) / VIEW.fx, (rows - VIEW.cy) / VIEW.fy, np.ones((80, 96))], -1)
    a, discriminant = (ray**2).sum(-1), 9 - (ray**2).sum(-1) * 8.75
    for got, sign in ((front, -1), (back, 1)):
        depth = (3 + sign * np.sqrt(np.maximum(discriminant, 0))) / a
        expected = (ray * depth[..., None] - [0, 0, 3]) / 0.5
        inner = discriminant > 0.1
        assert inner.sum() > 300
        assert np.abs(got[inner] - expected[inner]).max() < 0.02
        inside = np.abs(got).max(-1) > 0
        np.testing.assert_allclose(np.linalg.norm(got[inside], axis=-1), 1, atol=1e-5)
        assert not got[discriminant < 0].any()
    assert (np.abs(front).max(-1) > 0).sum() == (np.abs(back).max(-1) > 0).sum()


def test_encode():
    assert encode(np.array([[0.0, -1.0, 1.0], [0.6, 0.8, 0.0]])).tolist() == [[0, -127, 127], [76, 102, 0]]


def test_sign_test_accepts_this_convention_only():
    front, back = sphere_maps()
    assert sign_test(front, back).passed
    assert sign_test(encode(front), encode(back)).passed
    for flip in ([-1, 1, 1], [1, -1, 1], [1, 1, -1], [1, -1, -1], [-1, -1, -1]):
        assert not sign_test(front * flip, back * flip).passed
    assert not sign_test(back, front).passed
    assert not sign_test(front[:, ::-1], back[:, ::-1]).passed  # mirrored pixels
    assert not sign_test(np.zeros_like(front), back).passed


def test_unknown_provider_is_named():
    with pytest.raises(ConfigError, match="provider"):
        normal_provider({"provider": "pifu"}, normal_scenes.context([]))
    with pytest.raises(ConfigError, match="detail"):
        normal_provider({"provider": "body", "detail": 1}, normal_scenes.context([]))


def test_body_turned_away_keeps_the_convention():
    """A tilted, elongated body: the test is about axes, not about an upright person."""
    vertices, faces = sphere()
    centre = torch.tensor([0.0, 0.0, 3.0])
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(4)))[0]
    turn = turn * torch.det(turn)
    shaped = (vertices - centre) * torch.tensor([1.0, 0.4, 0.6]) @ turn.T + centre
    assert sign_test(*maps(shaped, faces)).passed
