"""What is known of every installed model file: ``records/<file>.json`` beside the files.

A record is written after its file, so a file without one is unfinished and is made again. The manifest is the records
of the catalogue in one file; it is only written when its content changes, since results depend on it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from soar.artifacts import read_json, sha256_file, write_json
from soar.models.catalogue import fetch_command
from soar.packages import verify


def read(folder: Path, file: str) -> dict[str, Any] | None:
    """The record of ``file`` (path below ``folder``), or None if it was never finished."""
    path = _path(folder, file)
    return read_json(path) if path.is_file() else None


def write(folder: Path, file: str, facts: dict[str, Any]) -> None:
    """Record a finished file: its sha256, size and ``facts``."""
    path = folder / file
    write_json(_path(folder, file), facts | {"file": file, "sha256": sha256_file(path), "bytes": path.stat().st_size})


def check(folder: Path, file: str) -> None:
    """Compare a file with its record, if it has one (a user's own file has none).

    Raises:
        ModelFileError: the file is altered or truncated.
    """
    record = read(folder, file)
    if record is not None:
        verify(folder / file, record["sha256"], f"delete the file and run {fetch_command(file)}; it is made again")


def write_manifest(folder: Path, files: list[str]) -> None:
    """Collect the records of the installed ``files`` in ``manifest.json``."""
    found = {file: record for file in sorted(files) if (record := read(folder, file)) and (folder / file).is_file()}
    path = folder / "manifest.json"
    if not path.is_file() or read_json(path) != found:
        write_json(path, found)


def _path(folder: Path, file: str) -> Path:
    return folder / "records" / f"{file}.json"
