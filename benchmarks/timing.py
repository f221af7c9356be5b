"""Timing that stands a busy machine: the figures compared are taken in turns, and the least of each counts."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping


def interleaved(jobs: Mapping[str, Callable[[], object]], rounds: Mapping[str, int]) -> dict[str, tuple[float, float]]:
    """Least and median wall time in milliseconds of each job, after one run to warm up."""
    for job in jobs.values():
        job()
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(max(rounds.values())):
        for name, job in jobs.items():
            if turn < rounds[name]:
                start = time.perf_counter()
                job()
                times[name].append(1e3 * (time.perf_counter() - start))
    return {name: (min(t), sorted(t)[len(t) // 2]) for name, t in times.items()}


def machine() -> str:
    """Processor class and load, for the record."""
    return f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
