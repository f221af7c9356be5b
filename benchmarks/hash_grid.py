"""Hash grid: native against torch, forward and forward + backward.

python -m benchmarks.hash_grid --log2-entries 17 --threads 2
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
import torch

from benchmarks.scenes import SURFELS, figure
from benchmarks.timing import interleaved, machine
from soar.raster import hash_encode


def main() -> None:
    """Print a table of milliseconds (least / median) and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=SURFELS)
    parser.add_argument("--levels", type=int, default=16)
    parser.add_argument("--log2-entries", type=int, default=17)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=10, help="runs of the native kernel; torch runs a fifth of it")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    positions = figure(arguments.points)[0]
    points = (positions - positions.amin(0)) / (positions.amax(0) - positions.amin(0))
    generator = torch.Generator().manual_seed(0)
    table = (1e-2 * torch.randn(arguments.levels, 1 << arguments.log2_entries, 2, generator=generator)).requires_grad_()
    resolutions = np.geomspace(16, 1024, arguments.levels).round().astype(int).tolist()
    upstream = torch.randn(arguments.points, 2 * arguments.levels, generator=generator)

    def job(backend: str, wanted: str) -> Callable[[], None]:
        x = points.clone().requires_grad_(wanted == "table and points")

        def run() -> None:
            with torch.set_grad_enabled(wanted != "forward"):
                codes = hash_encode(x, table, resolutions, backend)  # type: ignore[arg-type]
            if wanted != "forward":
                torch.autograd.grad(codes, [table] if wanted == "table" else [table, x], upstream)

        return run

    kinds = ("forward", "table", "table and points")
    jobs = {f"{backend} {kind}": job(backend, kind) for backend in ("native", "reference") for kind in kinds}
    rounds = {name: arguments.rounds if name.startswith("native") else max(arguments.rounds // 5, 1) for name in jobs}
    print(
        f"{arguments.points} points, {arguments.levels} levels of 2^{arguments.log2_entries}, "
        f"{arguments.threads} threads; {machine()}; 'table' and later include the forward pass"
    )
    figures = interleaved(jobs, rounds)
    for name, (least, median) in figures.items():
        print(f"  {name:28s} {least:8.1f} / {median:8.1f} ms")
    for kind in kinds:
        print(f"  ratio {kind:22s} {figures['reference ' + kind][0] / figures['native ' + kind][0]:8.1f}")


if __name__ == "__main__":
    main()
