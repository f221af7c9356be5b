"""Crops, windows in them, and the order in which they are drawn."""

import numpy as np
import pytest
import torch

from soar.avatar.puppet import Puppet
from soar.errors import ArtifactError
from soar.optimise.views import Views, epochs
from tests.avatar import toy
from tests.optimise import scene


@pytest.fixture(scope="module")
def views() -> Views:
    return scene.film(scene.truth())


def test_windows_hold_the_person_and_show_what_the_crop_shows(views: Views) -> None:
    tight = views.tightened(4, 8)
    for i in range(len(views)):
        top, bottom, left, right = tight.windows[i]
        assert (bottom - top) % 8 == 0
        assert (right - left) % 8 == 0
        outside = views.mask(i).clone()
        outside[top:bottom, left:right] = 0
        assert outside.max() <= 0.5
        torch.testing.assert_close(tight.image(i), views.image(i)[:, top:bottom, left:right])
        torch.testing.assert_close(tight.normal_maps(i)[1], views.normal_maps(i)[1][:, top:bottom, left:right])
        assert tight.share(i) == (bottom - top) * (right - left) / (96 * 128) < 1
        puppet = Puppet(scene.truth(), scene.articulation(), toy.RASTER)
        whole = puppet.render(i, views.T_cam_from_world, views.pinhole(i)).planes
        part = puppet.render(i, views.T_cam_from_world, tight.pinhole(i)).planes
        torch.testing.assert_close(part, whole[:, top:bottom, left:right], atol=1e-4, rtol=0)


def test_an_empty_mask_keeps_the_whole_crop(views: Views) -> None:
    import dataclasses

    empty = dataclasses.replace(views, alpha=np.zeros_like(views.alpha)).tightened(4)
    assert empty.share(0) == 1


def test_every_crop_comes_once_before_any_comes_again(views: Views) -> None:
    order = epochs([views, views], 20, torch.Generator().manual_seed(0))
    assert len(order) == 20
    assert set(order[:8]) == set(order[8:16]) == {(v, i) for v in range(2) for i in range(4)}
    assert order[:8] != order[8:16]
    assert order == epochs([views, views], 20, torch.Generator().manual_seed(0))


def test_normal_maps_of_another_clip_are_refused(views: Views) -> None:
    crops = {
        "rgb": views.rgb,
        "alpha": views.alpha,
        "K": views.K,
        "T_cam_from_world": np.eye(4),
        "frame_index": views.frames,
    }
    maps = {"front": views.normals[1:, 0], "back": views.normals[1:, 1]}
    with pytest.raises(ArtifactError, match="do not fit"):
        Views.of("x", crops, maps)


def test_hardened_masks_are_a_ramp_between_the_two_values(views: Views) -> None:
    hard = views.hardened(0.25, 0.75)
    soft = views.mask(0)
    expected = ((soft - 0.25) / 0.5).clamp(0, 1)
    torch.testing.assert_close(hard.mask(0), expected, atol=1 / 255, rtol=0)
    assert np.array_equal(views.hardened(0.0, 1.0).alpha, views.alpha)
