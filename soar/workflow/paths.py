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


def fill(path: str, sequence: str, camera: str | None) -> str:
    """A path with its placeholders ``{sequence}`` and ``{camera}`` filled in."""
    return path.replace("{sequence}", sequence).replace("{camera}", camera or "")


def files_of(path: str) -> list[str]:
    """What a job that is given ``path`` depends on: the file, or every file in a folder and below; itself if absent."""
    if not Path(path).is_dir():
        return [path]
    return sorted(str(file) for file in Path(path).rglob("*") if file.is_file())


def output_paths(stage: Stage, folder: str, camera: str | None) -> dict[str, str]:
    """Output name -> path of one job."""
    return {name: f"{folder}/{file}".replace("{camera}", camera or "") for name, file in stage.files.items()}
