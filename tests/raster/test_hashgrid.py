"""The hash grid: reference against loops, native against reference, gradients."""

import pytest
import torch

from soar.errors import InputError
from soar.raster import has_native, hash_encode

native = pytest.mark.skipif(not has_native(), reason="no native library")
RESOLUTIONS = [3, 7, 40, 300]


def brute_force(points, table, resolutions):
    levels, entries, features = table.shape
    out = torch.zeros(len(points), levels * features, dtype=torch.float64)
    for index, point in enumerate(points.tolist()):
        for level, n in enumerate(resolutions):
            cell = [min(int(x * n), n - 1) for x in point]
            for bits in range(8):
                corner = [c + (bits >> k & 1) for k, c in enumerate(cell)]
                weight = 1.0
                for x, c, k in zip(point, cell, range(3), strict=True):
                    weight *= (x * n - c) if bits >> k & 1 else 1 - (x * n - c)
                if (n + 1) ** 3 <= entries:
                    entry = corner[0] + (n + 1) * corner[1] + (n + 1) ** 2 * corner[2]
                else:
                    entry = (corner[0] ^ corner[1] * 2654435761 % 2**32 ^ corner[2] * 805459861 % 2**32) % entries
                out[index, level * features : (level + 1) * features] += weight * table[level, entry].double()
    return out


def inputs(count=50, features=2, dtype=torch.float64):
    g = torch.Generator().manual_seed(2)
    points = torch.rand(count, 3, generator=g)
    if count > 2:
        points[0], points[1] = 1.0, 0.0  # corners of the cube
    return points.to(dtype), torch.randn(len(RESOLUTIONS), 512, features, generator=g).to(dtype)


@pytest.mark.parametrize("features", [1, 2, 4])
def test_reference_equals_brute_force(features):
    points, table = inputs(features=features)
    torch.testing.assert_close(hash_encode(points, table, RESOLUTIONS), brute_force(points, table, RESOLUTIONS))


def test_reference_gradcheck():
    points, table = inputs(3)
    points = (points * 0.9 + 0.03).requires_grad_()
    table = table[:2, :64].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda p, t: hash_encode(p, t, RESOLUTIONS[:2]), (points, table))


@native
@pytest.mark.parametrize("count", [1, 7, 8, 600, 1025])
def test_native_equals_reference(count):
    points, table = (t.requires_grad_() for t in inputs(count))
    points32, table32 = (t.detach().float().requires_grad_() for t in (points, table))
    expected, got = hash_encode(points, table, RESOLUTIONS), hash_encode(points32, table32, RESOLUTIONS, "native")
    torch.testing.assert_close(got.double(), expected, rtol=0, atol=5e-5)  # 300 cells of float32 places
    upstream = torch.randn(expected.shape, generator=torch.Generator().manual_seed(1))
    for e, g in zip(
        torch.autograd.grad(expected, (points, table), upstream.double()),
        torch.autograd.grad(got, (points32, table32), upstream),
        strict=True,
    ):
        assert (g - e).norm() <= 3e-5 * e.norm()  # a float32 place in one of 300 cells is good to 2e-5


@native
def test_bitwise_equal_for_any_thread_count():
    points, table = (t.requires_grad_() for t in inputs(5000, dtype=torch.float32))
    threads, results = torch.get_num_threads(), []
    try:
        for count in (1, 2, 5):
            torch.set_num_threads(count)
            codes = hash_encode(points, table, RESOLUTIONS, "native")
            results.append([codes, *torch.autograd.grad(codes.square().sum(), (points, table))])
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))


@native
def test_beyond_the_cube_is_the_border_without_gradient():
    _, table = inputs(dtype=torch.float32)
    points = torch.tensor([[1.5, 0.5, -2.0]]).requires_grad_()
    for backend in ("native", "reference"):
        codes = hash_encode(points, table, RESOLUTIONS, backend)
        torch.testing.assert_close(codes, hash_encode(points.detach().clamp(0, 1), table, RESOLUTIONS, backend))
        (g,) = torch.autograd.grad(codes.sum(), points)
        assert g[0, 0] == g[0, 2] == 0
        assert g[0, 1] != 0


def test_errors():
    points, table = inputs()
    with pytest.raises(InputError, match="fit"):
        hash_encode(points, table[:, :500], RESOLUTIONS)
    with pytest.raises(InputError, match="fit"):
        hash_encode(points, table, RESOLUTIONS[:2])
    assert hash_encode(points[:0], table, RESOLUTIONS).shape == (0, 8)
