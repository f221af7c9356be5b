"""Multi-resolution hash grid (Mueller et al. 2022): definition in torch, and the native twin as an autograd function.

Level l cuts the unit cube into r_l^3 cells. A point in cell (i, j, k) blends the table entries of the cell's eight
corners trilinearly. Corner (i, j, k) has entry i + (r+1) j + (r+1)^2 k where all (r+1)^3 corners fit the level's table,
and (i xor 2654435761 j xor 805459861 k) mod T, in 32-bit arithmetic, where they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from soar.errors import InputError
from soar.raster.library import choose, library
from soar.raster.types import Backend

FACTORS = (1, 2654435761, 805459861)
NATIVE_FEATURES = 2


def hash_encode(
    points: Tensor, table: Tensor, resolutions: Sequence[int] | Tensor, backend: Backend = "auto"
) -> Tensor:
    """Codes of points in the unit cube, differentiable with respect to points and table.

    Args:
        points: (N, 3) in [0, 1]; coordinates beyond are taken to the border, with no gradient.
        table: (L, T, F) features; T is a power of two.
        resolutions: (L,) cells per axis.
        backend: the native kernel takes float32 and F = 2; ``auto`` gives anything else to the reference.

    Returns:
        (N, L F) codes, level by level.

    Raises:
        InputError: shapes do not fit.
        ConfigError: the backend cannot be had.
    """
    resolutions = [int(r) for r in resolutions]
    levels, entries, features = table.shape
    if points.ndim != 2 or points.shape[1] != 3 or len(resolutions) != levels or entries & (entries - 1):
        raise InputError(
            "a hash grid's arguments do not fit",
            expected="points (N, 3), table (L, T, F) with T a power of two, L resolutions",
            got=f"{tuple(points.shape)}, {tuple(table.shape)}, {len(resolutions)} resolutions",
        )
    if backend == "auto" and features != NATIVE_FEATURES:
        backend = "reference"
    if choose(backend, points, table) == "native":
        if features != NATIVE_FEATURES:
            raise InputError("the native hash grid has two features per entry", got=str(features), cure="use auto")
        return _Encode.apply(points, table, tuple(resolutions))
    return _reference(points, table, resolutions)


def _reference(points: Tensor, table: Tensor, resolutions: list[int]) -> Tensor:
    entries = table.shape[1]
    codes = []
    for level, n in zip(table, resolutions, strict=True):
        p = points.clamp(0, 1) * n
        cell = p.detach().floor().clamp_max(n - 1)
        place, cell = p - cell, cell.long()
        code: Tensor | int = 0
        for corner in range(8):
            bits = [corner >> k & 1 for k in range(3)]
            i, j, k = (cell[:, axis] + bit for axis, bit in enumerate(bits))
            if (n + 1) ** 3 <= entries:
                entry = i + (n + 1) * (j + (n + 1) * k)
            else:
                entry = (i * FACTORS[0] ^ j * FACTORS[1] ^ k * FACTORS[2]) & (entries - 1)
            weight = torch.stack([place[:, a] if bit else 1 - place[:, a] for a, bit in enumerate(bits)], 1).prod(1)
            code = code + weight[:, None] * level[entry]
        codes.append(code)
    return torch.cat(codes, 1)


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, resolutions: tuple[int, ...]) -> Tensor:
        points, table = points.detach().contiguous(), table.detach().contiguous()
        sizes = torch.tensor(resolutions, dtype=torch.int32)
        codes = points.new_empty(len(points), table.shape[0] * NATIVE_FEATURES)
        done = library().soar_hash_forward(
            points.data_ptr(), len(points), table.data_ptr(), *table.shape[:2], sizes.data_ptr(), codes.data_ptr(),
            torch.get_num_threads(),
        )  # fmt: skip
        if not done:
            raise MemoryError(f"the hash codes of {len(points)} points ran out of memory")
        ctx.save_for_backward(points, table, sizes)
        return codes

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, g_codes: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        points, table, sizes = ctx.saved_tensors
        g_codes = g_codes.contiguous()
        wanted = zip((points, table), ctx.needs_input_grad[:2], strict=True)
        g_points, g_table = (torch.empty_like(t) if needed else None for t, needed in wanted)
        done = library().soar_hash_backward(
            points.data_ptr(), len(points), table.data_ptr(), *table.shape[:2], sizes.data_ptr(), g_codes.data_ptr(),
            None if g_table is None else g_table.data_ptr(), None if g_points is None else g_points.data_ptr(),
            torch.get_num_threads(),
        )  # fmt: skip
        if not done:
            raise MemoryError(f"the hash gradient of {len(points)} points ran out of memory")
        return g_points, g_table, None
