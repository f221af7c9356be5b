"""The low-pass filter at body scale: the silhouette keeps its area and small surfels keep their gradients."""

import math

import pytest
import torch

from benchmarks.scenes import figure, view
from soar.raster import Pinhole, rasterise
from tests.conftest import conf
from tests.raster.scenes import raster
from tests.raster.supersampled import MAX_ALPHA, MIN_ALPHA, coverage

SIZE, FINE = 512, 2048


def test_mask_area_within_one_and_a_half_percent():
    surfels = figure()
    exact = coverage(*surfels[:3], view(SIZE), samples=4).sum()
    area = rasterise(*surfels, view(SIZE), side="front", settings=raster()).alpha.sum()
    assert abs(float(area) / exact - 1) < 0.015
    published = conf("raster", "surfels_reference")
    widened = rasterise(*surfels, view(SIZE), side="front", settings=raster(**published)).alpha.sum()
    assert float(widened) / exact > 1.025


@pytest.mark.parametrize("tilt", [0.0, 1.0, -1.2])
def test_the_exact_coverage_of_one_disk_is_its_integral(tilt):
    """Far away a disk's image is affine: 2 pi sigma^2 cos(tilt) times the integral of alpha over the Gaussian."""
    position, normal = torch.tensor([[0.3, -0.2, 100.0]]), torch.tensor([[math.sin(tilt), 0.0, -math.cos(tilt)]])
    pinhole = Pinhole(300.0, 200.0, 12.0, 14.0, 30, 28)
    mean = MAX_ALPHA - MIN_ALPHA + MAX_ALPHA * math.log(1 / MAX_ALPHA)
    facing = -float(normal[0] @ position[0]) / 100  # cosine of the tilt, seen along the ray
    sigma_x, sigma_y = (f * 1.1 / 100 for f in (pinhole.fx, pinhole.fy))
    got = coverage(position, normal, torch.tensor([1.1]), pinhole, samples=16).sum()
    assert got == pytest.approx(2 * math.pi * sigma_x * sigma_y * facing * mean, rel=0.005)
    behind = coverage(position, -normal, torch.tensor([1.1]), pinhole, samples=4)
    assert not behind.any()


def test_facing_surfels_receive_gradient():
    surfels = figure()
    colours = surfels[3].clone().requires_grad_()
    settings = raster(lowpass_px2=conf("raster", "default")["lowpass_px2"])
    rendered = rasterise(*surfels[:3], colours, surfels[4], view(SIZE), side="front", settings=settings)
    (g,) = torch.autograd.grad(rendered.colour.sum(), colours)
    positions, normals = surfels[:2]
    facing = (positions * normals).sum(1) < 0
    outside = surfels_on_the_outside()
    assert (g[facing & outside, 0] > 0).float().mean() >= 0.95


def surfels_on_the_outside() -> torch.Tensor:
    """Surfels that the front pass can show at all, not hidden in or behind a limb: seen at four times the size."""
    surfels = figure()
    colours = surfels[3].clone().requires_grad_()
    rendered = rasterise(*surfels[:3], colours, surfels[4], view(FINE), side="front", settings=raster())
    (g,) = torch.autograd.grad(rendered.colour.sum(), colours)
    return g[:, 0] > 0
