"""The native kernel against the float64 reference, and against itself with other thread counts."""

import gc

import pytest
import torch

from soar.errors import ConfigError
from soar.raster import Pinhole, has_native, rasterise, rasterise_both
from tests.raster.scenes import VIEW, cloud, raster

pytestmark = pytest.mark.skipif(not has_native(), reason="there is no C++ compiler and no built library")


def render(surfels, pinhole, upstream, backend, **changes):
    """Planes of both passes, and the gradients of the inputs under ``upstream``."""
    surfels = [t.detach().clone().requires_grad_() for t in surfels]
    both = [r.planes for r in rasterise_both(*surfels, pinhole, settings=raster(backend=backend, **changes))]
    return both, torch.autograd.grad(both, surfels, [u.to(both[0].dtype) for u in upstream])


def noise(pinhole, seed=3):
    g = torch.Generator().manual_seed(seed)
    return [torch.randn(9, pinhole.height, pinhole.width, generator=g) for _ in range(2)]


@pytest.mark.parametrize(("compensate", "cull"), [(True, True), (False, True), (True, False), (False, False)])
def test_values_and_gradients(compensate, cull):
    surfels = cloud(4000)
    upstream = noise(VIEW)
    changes = {"compensate": compensate, "cull": cull}
    expected, expected_g = render(surfels, VIEW, upstream, "reference", **changes)
    got, got_g = render([t.float() for t in surfels], VIEW, upstream, "native", **changes)
    for e, g in zip(expected, got, strict=True):
        assert e[7].mean() > 0.3
        assert (g - e).abs().mean() < 1e-6  # of values up to 3; float32 rounding
    for e, g in zip(expected_g, got_g, strict=True):
        assert (g - e).norm() / e.norm() < 1e-5  # this scene has no alpha within rounding of a threshold


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 5), (31, 17), (64, 33), (95, 79)])
def test_odd_sizes(width, height):
    pinhole = Pinhole(width * 1.7, width * 1.7, width / 2 - 0.3, height / 2 + 0.2, width, height)
    surfels = cloud(300)
    surfels[2] = surfels[2] * 96 / max(width, 16)
    upstream = noise(pinhole)
    expected, expected_g = render(surfels, pinhole, upstream, "reference")
    got, got_g = render([t.float() for t in surfels], pinhole, upstream, "native")
    for e, g in zip(expected, got, strict=True):
        torch.testing.assert_close(g.double(), e, rtol=1e-4, atol=2e-5)
    for e, g in zip(expected_g, got_g, strict=True):
        assert (g - e).norm() <= 2e-5 * e.norm()


@pytest.mark.parametrize("side", ["front", "back"])
def test_one_side_equals_its_half_of_both(side):
    surfels = cloud(2000, torch.float32)
    both = rasterise_both(*surfels, VIEW, settings=raster(backend="native"))
    one = rasterise(*surfels, VIEW, side=side, settings=raster(backend="native"))
    assert torch.equal(one.planes, both[side == "back"].planes)


def test_bitwise_equal_for_any_thread_count():
    surfels, upstream = cloud(20000, torch.float32), noise(VIEW)
    threads = torch.get_num_threads()
    results = []
    try:
        for count in (1, 2, 5):
            torch.set_num_threads(count)
            planes, gradients = render(surfels, VIEW, upstream, "native")
            results.append([*planes, *gradients])
    finally:
        torch.set_num_threads(threads)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_equal_depths_are_taken_by_index():
    surfels = cloud(400)
    surfels[0][:, 2] = 3.0
    upstream = noise(VIEW)
    expected, _ = render(surfels, VIEW, upstream, "reference", cull=False)
    got, _ = render([t.float() for t in surfels], VIEW, upstream, "native", cull=False)
    for e, g in zip(expected, got, strict=True):
        torch.testing.assert_close(g.double(), e, rtol=1e-4, atol=2e-5)


def test_a_wide_range_of_depths_is_sorted():
    """Keys that differ in all their bits need every pass of the radix sort."""
    surfels = cloud(3000)
    factor = torch.logspace(-2, 4, 3000, dtype=torch.float64).float().double()[torch.randperm(3000)]
    surfels[0] *= factor[:, None]
    surfels[2] *= factor
    surfels = [t.float().double() for t in surfels]
    expected, _ = render(surfels, VIEW, noise(VIEW), "reference")
    got, _ = render([t.float() for t in surfels], VIEW, noise(VIEW), "native")
    for e, g in zip(expected, got, strict=True):
        assert ((g - e).abs() > 1e-3 * e.abs().clamp_min(1)).float().mean() < 1e-3


def test_empty_behind_and_broken_surfels():
    for count in (0, 9):
        surfels = cloud(count, torch.float32)
        surfels[0][:, 2] *= -1
        planes, gradients = render(surfels, VIEW, noise(VIEW), "native")
        assert not any(p.any() for p in planes)
        assert not any(g.any() for g in gradients)
    surfels = cloud(3, torch.float32)
    surfels[0][0], surfels[1][1], surfels[2][2] = torch.nan, torch.nan, torch.inf
    planes, gradients = render(surfels, VIEW, noise(VIEW), "native")
    assert not any(p.any() for p in planes)
    assert not any(g.any() for g in gradients)


def test_backward_twice_and_of_one_pass():
    surfels = [t.requires_grad_() for t in cloud(500, torch.float32)]
    upstream = noise(VIEW)
    front, back = rasterise_both(*surfels, VIEW, settings=raster(backend="native"))
    first = torch.autograd.grad(front.planes, surfels, upstream[0], retain_graph=True)
    again = torch.autograd.grad([front.planes, back.planes], surfels, [upstream[0], torch.zeros_like(upstream[0])])
    for a, b in zip(first, again, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_contexts_survive_interleaved_views():
    """Two forward passes before either backward: pooled memory must not be shared."""
    upstream = noise(VIEW)
    a = [t.requires_grad_() for t in cloud(500, torch.float32, seed=5)]
    b = [t.requires_grad_() for t in cloud(700, torch.float32, seed=6)]
    settings = raster(backend="native")
    alone = torch.autograd.grad(rasterise(*a, VIEW, side="front", settings=settings).planes, a, upstream[0])
    gc.collect()
    ra = rasterise(*a, VIEW, side="front", settings=settings).planes
    rb = rasterise(*b, VIEW, side="front", settings=settings).planes
    torch.autograd.grad(rb, b, upstream[1])
    together = torch.autograd.grad(ra, a, upstream[0])
    assert all(torch.equal(x, y) for x, y in zip(alone, together, strict=True))


def test_float64_goes_to_the_reference_or_is_refused():
    surfels = cloud(10)
    assert rasterise(*surfels, VIEW, side="front", settings=raster(backend="auto")).planes.dtype == torch.float64
    with pytest.raises(ConfigError, match="float32"):
        rasterise(*surfels, VIEW, side="front", settings=raster(backend="native"))


def test_views_of_larger_tensors_are_taken():
    surfels = cloud(300, torch.float32)
    wide = torch.cat([surfels[0], surfels[1]], 1)
    got = rasterise(wide[:, :3], wide[:, 3:], *surfels[2:], VIEW, side="front", settings=raster(backend="native"))
    expected = rasterise(*surfels, VIEW, side="front", settings=raster(backend="native"))
    assert torch.equal(got.planes, expected.planes)
