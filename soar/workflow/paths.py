"""Where a job leaves its files, and what of them a stage receives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from soar.workflow.table import Stage


def benchmark_path(dataset: str, sequence: str, variant: str, stage: str, camera: str | None) -> str:
    """Where Snakemake writes wall time and memory of a job."""
    name = stage if camera is None else f"{stage}.{camera}"
    return f"results/{dataset}/{sequence}/{variant}/.jobs/{name}.tsv"


def folders(files: Mapping[str, str | Iterable[str]]) -> dict[str, str]:
    """What a stage receives: of a family of files, and of the models' manifest, the folder; nothing of no files."""
    result = {}
    for name, value in files.items():
        if isinstance(value, str):
            result[name] = str(Path(value).parent) if name == "models" else value
        elif first := next(iter(value), None):
            result[name] = str(Path(first).parent)
    return result


def output_paths(stage: Stage, folder: str, camera: str | None) -> dict[str, str]:
    """Output name -> path of one job."""
    return {name: f"{folder}/{file}".replace("{camera}", camera or "") for name, file in stage.files.items()}
