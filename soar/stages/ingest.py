"""Check the user's recordings and calibration, choose frames, and write the sequence's record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.datasets import adapter
from soar.datasets.ingest import describe
from soar.stages import Job


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write ``sequence.json``."""
    describe(adapter(cfg["dataset"]).capture(job.sequence)).write(outputs["sequence"])
