"""Surfel rasteriser: native against reference, forward and forward + backward.

python -m benchmarks.raster --size 512 --threads 2
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

from benchmarks.scenes import SURFELS, figure, view
from benchmarks.timing import interleaved, machine
from soar.raster import RasterSettings, Rendered, rasterise, rasterise_both


def main() -> None:
    """Print a table of milliseconds (least / median) and the ratios that are accepted or not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512, help="side of the image in pixels")
    parser.add_argument("--surfels", type=int, default=SURFELS)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15, help="runs of the native kernel; a fifth of the reference")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    surfels = [t.requires_grad_() for t in figure(arguments.surfels)]
    pinhole = view(arguments.size)
    upstream = torch.randn(9, arguments.size, arguments.size, generator=torch.Generator().manual_seed(0))

    def job(backend: str, both: bool, backward: bool) -> Callable[[], None]:
        settings = RasterSettings(lowpass_px2=1 / 12, compensate=True, cull=True, backend=backend)  # type: ignore[arg-type]

        def run() -> None:
            with torch.set_grad_enabled(backward):
                if both:
                    renders: tuple[Rendered, ...] = rasterise_both(*surfels, pinhole, settings=settings)
                else:
                    renders = (rasterise(*surfels, pinhole, side="front", settings=settings),)
            if backward:
                planes = [r.planes for r in renders]
                torch.autograd.grad(planes, surfels, [upstream] * len(planes))

        return run

    jobs = {
        f"{backend} {'front+back' if both else 'front'} {'F+B' if backward else 'F'}": job(backend, both, backward)
        for backend in ("native", "reference")
        for both in (False, True)
        for backward in (False, True)
    }
    rounds = {name: arguments.rounds if name.startswith("native") else max(arguments.rounds // 5, 1) for name in jobs}
    print(f"{arguments.surfels} surfels, {arguments.size}^2, {arguments.threads} threads; {machine()}")
    figures = interleaved(jobs, rounds)
    for name, (least, median) in figures.items():
        print(f"  {name:28s} {least:8.1f} / {median:8.1f} ms")
    for what in ("front F", "front F+B", "front+back F+B"):
        print(f"  ratio {what:22s} {figures['reference ' + what][0] / figures['native ' + what][0]:8.1f}")


if __name__ == "__main__":
    main()
