"""A table of the model files: what is there, what is missing, licence, source, use."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from soar.artifacts import read_json, sha256_file
from soar.models import records
from soar.models.catalogue import CATALOGUE, Model


@dataclasses.dataclass(frozen=True)
class Row:
    """One model: ``state`` is ready, missing, optional (missing, but not needed), unfinished
    or altered; ``bytes`` on disk."""

    name: str
    state: str
    bytes: int
    licence: str
    source: str
    feeds: str


def describe(folder: Path) -> list[Row]:
    """One row per model of the catalogue; every installed file is compared with its recorded sha256."""
    rows = []
    for model in CATALOGUE.values():
        path = folder / model.file
        source = ", ".join(str(source.archive) for source in model.sources)
        size = path.stat().st_size if path.is_file() else 0
        rows.append(Row(model.name, _state(model, folder), size, model.licence, source, model.feeds))
    return rows


def bundled(folder: Path) -> list[Row]:
    """One row per network that comes with the package, from the records in ``folder``."""
    rows = []
    for path in sorted((folder / "records").glob("*.json")):
        record = read_json(path)
        state = "ready" if sha256_file(folder / record["file"]) == record["sha256"] else "altered"
        source = "bundled, trained by `python -m soar train`"
        rows.append(Row(f"mini {record['name']}", state, record["bytes"], record["licence"], source, record["feeds"]))
    return rows


def _state(model: Model, folder: Path) -> str:
    record = records.read(folder, model.file)
    if not (folder / model.file).is_file():
        return "optional" if model.optional else "missing"
    if record is None:
        return "unfinished"
    return "ready" if sha256_file(folder / model.file) == record["sha256"] else "altered"


def table(rows: list[Row]) -> str:
    """The rows as aligned text."""
    lines = [("model", "state", "MB", "licence", "source", "feeds")]
    lines += [(r.name, r.state, f"{r.bytes / 1e6:.1f}" if r.bytes else "-", r.licence, r.source, r.feeds) for r in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)
