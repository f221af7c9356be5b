"""The reconstruction loop on a toy: it learns, resumes to the same bits, and stops at the first NaN."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

import soar.optimise.reconstruct as module
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.errors import NumericalError
from soar.losses.lpips import Lpips
from soar.metrics.masked import iou
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.reconstruct import ReconstructSettings, reconstruct
from soar.optimise.views import Views
from tests.avatar import toy
from tests.conftest import conf
from tests.optimise import scene

_CPU = settings(ReconstructSettings, conf("reconstruct", "cpu"))
SETTINGS = dataclasses.replace(
    _CPU,
    steps=40,
    reskin_every=8,
    checkpoint_seconds=0.0,
    weights=dataclasses.replace(_CPU.weights, lpips=0.0, normal_lpips=0.0),
)


LEFT = torch.tensor([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def views() -> Views:
    return scene.film(scene.truth())


def run(
    views: Views,
    path: Path,
    attributes: str = "explicit",
    options: ReconstructSettings = SETTINGS,
    lpips: Lpips | None = None,
) -> tuple[Avatar, dict[str, list[float]]]:
    avatar = toy.avatar_settings(attributes)
    checkpoint = Checkpoint(path, "toy", options.checkpoint_seconds)
    body = scene.start(), scene.articulation(), LEFT
    return reconstruct(*body, [views], lpips, avatar, options, toy.RASTER, 0, checkpoint)


def same(a: Avatar, b: Avatar) -> bool:
    return all(torch.equal(getattr(a, n), getattr(b, n)) for n in ("positions", "quaternions", "scales", "colours"))


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_colours_and_silhouette_are_learned(views: Views, tmp_path: Path, attributes: str) -> None:
    options = dataclasses.replace(
        SETTINGS, steps=100, rates=dataclasses.replace(SETTINGS.rates, field=2e-2, colours=2e-2)
    )
    avatar, curves = run(views, tmp_path / "s.pt", attributes, options)
    assert np.mean(curves["l1"][-8:]) < 0.35 * np.mean(curves["l1"][:4])
    assert set(curves) == {
        "l1",
        "ssim",
        "mask",
        "mask_back",
        "normal_cosine",
        "normal_depth",
        "offset",
        "laplacian",
        "scale_log",
    }
    assert all(len(curve) == 100 for curve in curves.values())

    def overlap(a: Avatar) -> float:
        puppet = Puppet(a, scene.articulation(), toy.RASTER)
        return float(
            np.mean(
                [
                    iou(puppet.render(t, views.T_cam_from_world, views.pinhole(t)).alpha.numpy(), views.mask(t).numpy())
                    for t in range(4)
                ]
            )
        )

    assert overlap(avatar) > overlap(scene.start()) + 0.02
    assert (avatar.colours >= 0).all()
    assert (avatar.colours <= 1).all()
    assert (avatar.scales > 0).all()


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_a_killed_run_ends_with_the_same_bits(
    views: Views, tmp_path: Path, attributes: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, curves = run(views, tmp_path / "whole.pt", attributes)
    terms, seen = module.image_terms, []

    def dying(*arguments: object) -> dict[str, torch.Tensor]:
        seen.append(1)
        if len(seen) == 21:
            raise KeyboardInterrupt
        return terms(*arguments)

    monkeypatch.setattr(module, "image_terms", dying)
    with pytest.raises(KeyboardInterrupt):
        run(views, tmp_path / "killed.pt", attributes)
    seen.clear()
    monkeypatch.setattr(module, "image_terms", lambda *a: (seen.append(1), terms(*a))[1])
    again, continued = run(views, tmp_path / "killed.pt", attributes)
    assert len(seen) == SETTINGS.steps - 20
    assert same(whole, again)
    assert continued == curves


def test_the_first_nan_is_named_and_the_state_before_it_kept(
    views: Views, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms, seen = module.image_terms, []

    def failing(*arguments: object) -> dict[str, torch.Tensor]:
        seen.append(1)
        values = terms(*arguments)
        return values | {"mask": values["mask"] * float("nan")} if len(seen) == 6 else values

    monkeypatch.setattr(module, "image_terms", failing)
    with pytest.raises(NumericalError, match=r"step 5: loss term mask is not finite") as caught:
        run(views, tmp_path / "s.pt")
    assert str(tmp_path / "s.pt") in str(caught.value)
    state = Checkpoint(tmp_path / "s.pt", "toy", 0).load()
    assert state is not None
    assert state["step"] == 5
    assert all(torch.isfinite(v).all() for v in state["surface"].values())


def test_a_bad_gradient_is_named(views: Views, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terms = module.surface_terms

    def failing(positions: torch.Tensor, *arguments: object) -> dict[str, torch.Tensor]:
        values = terms(positions, *arguments)
        return values | {"offset": values["offset"] + (0 * positions.sum()).sqrt()}

    monkeypatch.setattr(module, "surface_terms", failing)
    with pytest.raises(NumericalError, match=r"gradient of positions"):
        run(views, tmp_path / "s.pt")


def test_perceptual_terms_take_part(views: Views, tmp_path: Path) -> None:
    from tests.conftest import model_file

    lpips = Lpips.load(model_file("lpips_alex.safetensors"), "alex")
    weights = dataclasses.replace(SETTINGS.weights, lpips=0.5, normal_lpips=0.1, curvature=0.1, scale_mean=0.1)
    results = []
    for cache_mb in (64, 0):
        options = dataclasses.replace(SETTINGS, steps=6, weights=weights, cache_mb=cache_mb)
        avatar, curves = run(views, tmp_path / f"{cache_mb}.pt", options=options, lpips=lpips)
        assert curves["lpips"][0] > 0
        assert curves["normal_lpips"][0] > 0
        assert curves["curvature"][0] > 0
        results.append(avatar)
    assert same(*results)
