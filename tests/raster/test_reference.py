"""The specification itself: against a loop over pixels and surfels, and by finite differences."""

import math

import pytest
import torch

from soar.errors import ConfigError, InputError
from soar.raster import Pinhole, rasterise, rasterise_both
from tests.raster.scenes import VIEW, cloud, raster

REFERENCE = {"backend": "reference"}


def brute_force(surfels, pinhole, side, lowpass, compensate, cull):
    """One pixel and one surfel at a time, in plain numbers, with matrices instead of closed forms."""
    planes = torch.zeros(9, pinhole.height, pinhole.width, dtype=torch.float64)
    items = []
    for p, n, s, c, o in zip(*surfels, strict=True):
        x, y, z = p.tolist()
        if z <= 0.01:
            continue
        r = torch.tensor([x / z, y / z, 1.0], dtype=torch.float64)
        cosine = float(n @ r)
        if cull and (cosine >= 0 if side == "front" else cosine <= 0):
            continue
        rows = [[pinhole.fx / z, 0, -pinhole.fx * x / z**2], [0, pinhole.fy / z, -pinhole.fy * y / z**2]]
        jacobian = torch.tensor(rows, dtype=torch.float64)
        sharp = s**2 * jacobian @ (torch.eye(3).double() - torch.outer(n, n)) @ jacobian.T
        blurred = sharp + lowpass * torch.eye(2).double()
        opacity = math.sqrt(max(float(torch.det(sharp)), 0) / float(torch.det(blurred))) if compensate else 1.0
        centre = torch.tensor([pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy], dtype=torch.float64)
        slope = math.copysign(max(abs(cosine), 0.1), cosine)
        zx, zy = -z * n[0] / (pinhole.fx * slope), -z * n[1] / (pinhole.fy * slope)
        items.append((z, centre, torch.linalg.inv(blurred), opacity, c, n, o, zx, zy))
    items.sort(key=lambda item: item[0] if side == "front" else -item[0])
    for row in range(pinhole.height):
        for column in range(pinhole.width):
            open_share = 1.0
            for z, centre, inverse, opacity, c, n, o, zx, zy in items:
                d = torch.tensor([column + 0.5, row + 0.5], dtype=torch.float64) - centre
                alpha = min(0.99, opacity * math.exp(-0.5 * float(d @ inverse @ d)))
                if alpha < 1 / 255:
                    continue
                if open_share <= 1e-4:
                    break
                w = open_share * alpha
                depth = z + zx * d[0] + zy * d[1]
                planes[:, row, column] += w * torch.cat([c, n, depth[None], torch.ones(1).double(), o[None]])
                open_share *= 1 - alpha
    return planes


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize(("compensate", "cull"), [(True, True), (False, True), (True, False)])
def test_equals_brute_force(side, compensate, cull):
    pinhole = Pinhole(30.0, 29.0, 8.6, 6.9, 17, 13)
    surfels = cloud(60)
    surfels[1] = torch.nn.functional.normalize(surfels[1], dim=-1)  # closed forms hold for unit length
    surfels[2] = surfels[2] * 4
    settings = raster(**REFERENCE, compensate=compensate, cull=cull)
    got = rasterise(*surfels, pinhole, side=side, settings=settings).planes
    expected = brute_force(surfels, pinhole, side, settings.lowpass_px2, compensate, cull)
    assert got.shape == (9, 13, 17)
    assert expected[7].max() > 0.5
    torch.testing.assert_close(got, expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("side", ["front", "back"])
def test_gradcheck(side):
    """Three overlapping surfels a pixel or two wide; no alpha near its clamp, no pixel near its end."""
    sign = -1.0 if side == "front" else 1.0
    positions = torch.tensor([[0.03, 0.02, 2.0], [-0.13, 0.06, 2.2], [0.16, -0.05, 2.5]], dtype=torch.float64)
    normals = torch.tensor([[0.4, 0.1, sign], [-0.5, 0.4, sign], [0.1, -0.6, sign]], dtype=torch.float64)
    normals = torch.nn.functional.normalize(normals, dim=-1)
    scales = torch.tensor([0.22, 0.25, 0.28], dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    colours, occlusion = torch.rand(3, 3, generator=generator).double(), torch.rand(3, generator=generator).double()
    inputs = [t.requires_grad_() for t in (positions, normals, scales, colours)]
    pinhole = Pinhole(10.0, 11.0, 3.0, 2.0, 6, 4)

    def planes(*surfels):
        # Every channel but occlusion, whose gradient is held back from geometry on purpose.
        return rasterise(*surfels, occlusion, pinhole, side=side, settings=raster(**REFERENCE)).planes[:8]

    alpha = planes(*inputs)[7]
    assert alpha.max() < 0.999
    assert (alpha > 0.3).sum() > 12
    assert torch.autograd.gradcheck(planes, inputs)


def test_occlusion_gradient_reaches_occlusion_only():
    surfels = [t.requires_grad_() for t in cloud(200)]
    rendered = rasterise(*surfels, VIEW, side="front", settings=raster(**REFERENCE))
    *others, g = torch.autograd.grad(rendered.occlusion.sum(), surfels, allow_unused=True)
    assert g.abs().sum() > 1
    assert all(o is None or not o.any() for o in others)


def test_uniform_occlusion_renders_as_alpha():
    surfels = cloud(500)
    surfels[4] = torch.ones(500, dtype=torch.float64)
    rendered = rasterise(*surfels, VIEW, side="front", settings=raster(**REFERENCE))
    torch.testing.assert_close(rendered.occlusion, rendered.alpha)


def test_plane_has_its_depth_and_normal():
    """A dense tilted plane: expected depth is the ray's, though every surfel has one depth of its own."""
    n = torch.nn.functional.normalize(torch.tensor([0.4, -0.3, -1.0]).double(), dim=0)
    u, v = torch.meshgrid(torch.linspace(-1, 1, 60).double(), torch.linspace(-1, 1, 60).double(), indexing="ij")
    z = (n[2] * 3 - n[0] * u - n[1] * v) / n[2]
    positions = torch.stack([u, v, z], -1).reshape(-1, 3)
    count = len(positions)
    others = torch.full((count,), 0.05), torch.ones(count, 3), torch.zeros(count)
    surfels = positions, n.expand(count, 3), *(t.double() for t in others)
    rendered = rasterise(*surfels, VIEW, side="front", settings=raster(**REFERENCE))
    rows, columns = torch.meshgrid(torch.arange(30, 50) + 0.5, torch.arange(40, 60) + 0.5, indexing="ij")
    ray = torch.stack([(columns - VIEW.cx) / VIEW.fx, (rows - VIEW.cy) / VIEW.fy, torch.ones_like(rows)], -1).double()
    expected = 3 * n[2] / (ray @ n)
    window = (slice(30, 50), slice(40, 60))
    depth = rendered.depth[window] / rendered.alpha[window]
    # The affine slope is exact to first order: over the footprint's 3 sigma what is left is under a millimetre.
    torch.testing.assert_close(depth, expected, atol=1e-3, rtol=0)
    normal = rendered.normal[:, 30:50, 40:60] / rendered.alpha[window]
    torch.testing.assert_close(normal, n[:, None, None].expand(3, 20, 20))


def test_empty_and_behind():
    for count in (0, 5):
        surfels = cloud(count)
        surfels[0][:, 2] *= -1
        for r in rasterise_both(*surfels, VIEW, settings=raster(**REFERENCE)):
            assert r.planes.shape == (9, 80, 96)
            assert not r.planes.any()


def test_errors_name_the_cause():
    surfels = cloud(4)
    with pytest.raises(InputError, match="do not fit"):
        rasterise(*surfels[:4], surfels[4][:3], VIEW, side="front", settings=raster())
    with pytest.raises(ConfigError, match="lowpass"):
        raster(lowpass_px2=0.0)
    with pytest.raises(InputError, match="view"):
        Pinhole(1.0, 1.0, 0.0, 0.0, 0, 4)
