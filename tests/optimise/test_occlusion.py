"""tau on a toy that turns only one side to the camera."""

import dataclasses

import numpy as np
import torch

from soar.config import settings
from soar.optimise.occlusion import OcclusionSettings, occlusion
from tests.avatar import toy
from tests.conftest import conf
from tests.optimise import scene

SETTINGS = settings(OcclusionSettings, conf("occlusion", "default"))


def test_tau_separates_the_two_sides() -> None:
    truth = scene.truth()
    result = occlusion(truth, scene.articulation(), [scene.film(truth)], SETTINGS, toy.RASTER, 0)
    tau, y = result.avatar.occlusion, truth.rest_positions[:, 1]
    # A few surfels of the front lie wholly under their neighbours.
    assert (tau[y < -0.06] < 0.1).float().mean() > 0.97
    assert tau[y > 0.08].min() > 0.9
    assert result.undecided < 0.02
    assert np.isclose(result.bor, float(tau.mean()), atol=1e-6)
    area = truth.scales**2
    assert np.isclose(result.bor_area, float((tau * area).sum() / area.sum()), atol=1e-6)
    assert 0.35 < result.bor_area < 0.55


def test_nothing_but_tau_changes_and_the_start_does_not_matter() -> None:
    truth = scene.truth()
    views = [scene.film(truth)]
    a = occlusion(truth, scene.articulation(), views, SETTINGS, toy.RASTER, 0)
    b = occlusion(truth.replace(occlusion=0 * truth.occlusion), scene.articulation(), views, SETTINGS, toy.RASTER, 0)
    assert torch.equal(a.avatar.occlusion, b.avatar.occlusion)
    for name in ("positions", "quaternions", "scales", "colours", "rest_positions"):
        assert torch.equal(getattr(a.avatar, name), getattr(truth, name))


def test_culling_is_switched_on_whatever_the_settings_say() -> None:
    truth = scene.truth()
    open_raster = dataclasses.replace(toy.RASTER, cull=False)
    views = [scene.film(truth)]
    a = occlusion(truth, scene.articulation(), views, SETTINGS, open_raster, 0)
    b = occlusion(truth, scene.articulation(), views, SETTINGS, toy.RASTER, 0)
    assert a.bor == b.bor


def test_more_views_and_a_stricter_threshold() -> None:
    truth = scene.truth()
    front, back = scene.film(truth), scene.film(truth, azimuth=np.pi)
    one = occlusion(truth, scene.articulation(), [front], SETTINGS, toy.RASTER, 0)
    both = occlusion(truth, scene.articulation(), [front, back], SETTINGS, toy.RASTER, 0)
    assert both.bor < 0.1 * one.bor
    strict = dataclasses.replace(SETTINGS, min_coverage=0.3)
    assert occlusion(truth, scene.articulation(), [front], strict, toy.RASTER, 0).bor > one.bor


def test_every_frame_is_drawn_even_with_fewer_steps() -> None:
    truth = scene.truth()
    few = dataclasses.replace(SETTINGS, steps=1, visits=1, rate=20.0)
    result = occlusion(truth, scene.articulation(6), [scene.film(truth, 6)], few, toy.RASTER, 0)
    tau, y = result.avatar.occlusion, truth.rest_positions[:, 1]
    assert (tau[y < -0.08] < 0.1).float().mean() > 0.97


def test_what_few_frames_show_is_decided_by_visiting_them_again() -> None:
    truth = scene.truth()
    shown_once = [scene.film(truth, 12, azimuth=np.pi), scene.film(truth, 1)]
    undecided = [
        occlusion(truth, scene.articulation(12), shown_once, settings, toy.RASTER, 0).undecided
        for settings in (dataclasses.replace(SETTINGS, steps=1, visits=visits) for visits in (1, 12))
    ]
    assert undecided[0] > 0.2 > 0.02 > undecided[1]
