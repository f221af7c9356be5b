"""The paint baseline on a toy whose colours are known."""

import numpy as np
import pytest
import torch

from soar.config import settings
from soar.errors import SubjectError
from soar.optimise.paint import PaintSettings, paint, sample
from tests.avatar import toy
from tests.conftest import conf
from tests.optimise import scene

SETTINGS = settings(PaintSettings, conf("paint", "default"))


def test_seen_surfels_take_their_colour_and_unseen_ones_a_neighbours() -> None:
    truth = scene.truth()
    avatar, seen = paint(
        truth.replace(colours=torch.full_like(truth.colours, 0.5)),
        scene.articulation(),
        [scene.film(truth)],
        SETTINGS,
        toy.RASTER,
    )
    y = truth.rest_positions[:, 1]
    assert seen[y < -0.05].float().mean() > 0.95
    assert not seen[y > 0.08].any()
    assert torch.equal(avatar.occlusion, (~seen).float())
    # Away from the seams between colours the painted colour is the true one.
    inner = (
        seen
        & ((truth.rest_positions[:, 2] - 0.5).abs() > 0.1)
        & (y < -0.05)
        & ((truth.rest_positions[:, 2] - 0.5).abs() < 0.5)
    )
    assert (avatar.colours - truth.colours).abs()[inner].max() < 0.05
    # The back was never seen: no blue there.
    assert avatar.colours[y > 0.1, 2].max() < 0.5


def test_a_second_camera_sees_the_back() -> None:
    truth = scene.truth()
    films = [scene.film(truth), scene.film(truth, azimuth=np.pi)]
    avatar, seen = paint(truth, scene.articulation(), films, SETTINGS, toy.RASTER)
    assert seen.float().mean() > 0.9
    assert avatar.colours[truth.rest_positions[:, 1] > 0.1, 2].min() > 0.8


def test_a_body_outside_the_mask_is_named() -> None:
    import dataclasses

    views = scene.film(scene.truth())
    with pytest.raises(SubjectError, match="no surfel"):
        paint(
            scene.truth(),
            scene.articulation(),
            [dataclasses.replace(views, alpha=0 * views.alpha)],
            SETTINGS,
            toy.RASTER,
        )


def test_sample_is_bilinear_at_pixel_centres() -> None:
    planes = torch.arange(12.0).reshape(1, 3, 4)
    got = sample(planes, torch.tensor([[0.5, 0.5], [3.5, 2.5], [1.0, 0.5], [-5.0, 0.5]]))
    torch.testing.assert_close(got, torch.tensor([[0.0, 11.0, 0.5, 0.0]]))
