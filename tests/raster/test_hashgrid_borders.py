"""The native hash grid where its blocks of 512 points and lanes of 8 end, and where the cube does."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from soar.raster import has_native, hash_encode
from soar.raster.library import library

pytestmark = pytest.mark.skipif(not has_native(), reason="no native library")

COUNTS = [1, 7, 511, 512, 513]
RESOLUTIONS = [4, 9, 64]  # two levels whose corners fit the table, one that is hashed
ENTRIES = 1024
CODES = 2 * len(RESOLUTIONS)


def table() -> Tensor:
    return torch.randn(len(RESOLUTIONS), ENTRIES, 2, generator=torch.Generator().manual_seed(0))


def points(count: int) -> Tensor:
    """In the cube and a little beyond; every fifth lies on borders of cells, some of them on the cube's."""
    drawn = 1.2 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 0.1
    drawn[::5] = (drawn[::5] * 4).round() / 4
    return drawn


def upstream(count: int) -> Tensor:
    return torch.randn(count, CODES, generator=torch.Generator().manual_seed(2))


def results(at: Tensor, pushed: Tensor, backend: str = "native", dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """Codes, and the gradients of points and table."""
    places, entries = at.to(dtype).requires_grad_(), table().to(dtype).requires_grad_()
    codes = hash_encode(places, entries, RESOLUTIONS, backend)
    return [codes.detach(), *torch.autograd.grad(codes, (places, entries), pushed.to(dtype))]


@pytest.mark.parametrize("count", COUNTS)
def test_every_entry_equals_the_reference(count: int) -> None:
    at, pushed = points(count), upstream(count)
    expected = results(at, pushed, "reference", torch.float64)
    for name, got, wanted in zip(("codes", "points", "table"), results(at, pushed), expected, strict=True):
        tolerance = 2e-5 * float(wanted.abs().max())
        torch.testing.assert_close(got.double(), wanted, rtol=0, atol=tolerance, msg=f"{name}: {got} {wanted}")


@pytest.mark.parametrize("count", COUNTS)
def test_one_thread_and_two_give_the_same_bits(count: int) -> None:
    threads, found = torch.get_num_threads(), []
    try:
        for number in (1, 2):
            torch.set_num_threads(number)
            found.append(results(points(count), upstream(count)))
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


@pytest.mark.parametrize("count", COUNTS)
def test_a_point_s_code_and_gradient_do_not_depend_on_its_company(count: int) -> None:
    at, pushed = points(1030), upstream(1030)
    whole = results(at, pushed)
    for first in (0, 3, 509):
        part = slice(first, first + count)
        for a, b in zip(results(at[part], pushed[part])[:2], whole[:2], strict=True):
            assert torch.equal(a, b[part])


@pytest.mark.parametrize("count", COUNTS)
def test_nothing_is_written_beyond_the_last_point(count: int) -> None:
    at, pushed, entries = points(count), upstream(count), table()
    sizes = torch.tensor(RESOLUTIONS, dtype=torch.int32)
    grid = at.data_ptr(), count, entries.data_ptr(), *entries.shape[:2], sizes.data_ptr()
    codes, g_points, g_table = (
        torch.full((rows, width), 7.5) for rows, width in ((count + 16, CODES), (count + 16, 3), (3 * ENTRIES + 8, 2))
    )
    assert library().soar_hash_forward(*grid, codes.data_ptr(), 2)
    assert library().soar_hash_backward(*grid, pushed.data_ptr(), g_table.data_ptr(), g_points.data_ptr(), 2)
    expected = results(at, pushed)
    for found, wanted in zip((codes, g_points, g_table), expected, strict=True):
        wanted = wanted.reshape(-1, found.shape[1])
        assert torch.equal(found[: len(wanted)], wanted)
        assert (found[len(wanted) :] == 7.5).all()


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_coordinate_beyond_the_cube_has_no_gradient_and_the_others_that_of_the_border(backend: str) -> None:
    sides = torch.tensor([-3.0, -1e-6, 0.0, 0.3, 0.77, 1.0, 1.0 + 1e-6, 40.0])
    at = torch.cartesian_prod(sides, sides, sides)
    pushed = upstream(len(at))
    codes, gradient, g_table = results(at, pushed, backend)
    border, on_border, same_table = results(at.clamp(0, 1), pushed, backend)
    beyond = (at < 0) | (at > 1)
    assert int(beyond.all(1).sum()) == 4**3
    assert torch.equal(codes, border)
    assert (gradient[beyond] == 0).all()
    assert torch.equal(gradient[~beyond], on_border[~beyond])
    assert (on_border != 0).all()
    assert torch.equal(g_table, same_table)


def test_a_gradient_is_the_same_whether_or_not_the_other_is_wanted() -> None:
    at, pushed = points(513), upstream(513)
    _, both_points, both_table = results(at, pushed)
    places, entries = at.clone().requires_grad_(), table().requires_grad_()
    alone = hash_encode(places, table(), RESOLUTIONS, "native"), hash_encode(at, entries, RESOLUTIONS, "native")
    assert torch.equal(*torch.autograd.grad(alone[0], places, pushed), both_points)
    assert torch.equal(*torch.autograd.grad(alone[1], entries, pushed), both_table)


def test_memory_need_not_lie_in_order() -> None:
    at, pushed = points(20), upstream(20)
    turned = at.T.contiguous().T, pushed.T.contiguous().T
    assert not any(t.is_contiguous() for t in turned)
    assert all(torch.equal(a, b) for a, b in zip(results(*turned), results(at, pushed), strict=True))
