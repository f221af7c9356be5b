"""The low-pass filter at body scale: the silhouette keeps its area and small surfels keep their gradients."""

import torch

from benchmarks.scenes import figure, view
from soar.raster import rasterise
from tests.conftest import conf
from tests.raster.scenes import raster

SIZE, FINE = 512, 2048


def test_mask_area_within_one_and_a_half_percent():
    surfels = figure()
    area = rasterise(*surfels, view(SIZE), side="front", settings=raster()).alpha.sum() / SIZE**2
    # At sixteen samples per pixel the filter is a quarter of a pixel wide; what is left of it is far below the bound.
    exact = rasterise(*surfels, view(FINE), side="front", settings=raster()).alpha.sum() / FINE**2
    assert abs(area / exact - 1) < 0.015
    published = conf("raster", "surfels_reference")
    widened = rasterise(*surfels, view(SIZE), side="front", settings=raster(**published)).alpha.sum() / SIZE**2
    assert widened / exact > 1.025


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
