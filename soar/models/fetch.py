"""Bring model files: re-use what is there and right, fetch, check, convert the rest.

Archives are fetched once for all their members into a temporary folder and removed afterwards; the clients keep caches
of their own.
"""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from soar.artifacts import atomic_path, write_tensors
from soar.errors import ModelFileError, StorageError
from soar.models import anny_export, convert, lpips_weights, records
from soar.models.anny_export import AnnySettings
from soar.models.catalogue import Member, Model
from soar.packages import Archive, download, member, verify_digest


@dataclasses.dataclass(frozen=True)
class ModelsSettings:
    """Node ``models`` of the configuration.

    Attributes:
        extra: names of optional models to fetch besides the default ones.
        anny: shape space of the default body.
    """

    extra: tuple[str, ...]
    anny: AnnySettings


def ensure(models: Sequence[Model], folder: Path, settings: ModelsSettings, offline: bool = False) -> None:
    """Make every model file be in ``folder``, with its record.

    Args:
        models: what is needed.
        folder: the models folder.
        settings: how derived files are made.
        offline: never fetch.

    Raises:
        ModelFileError: an installed file is altered; or one is missing and cannot be fetched, or is not the pinned one.
        StorageError: the disk is full or not writable.
    """
    pending = [model for model in models if not _installed(model, folder, settings)]
    if pending and offline:
        raise ModelFileError(
            "model files are missing", expected=", ".join(str(folder / model.file) for model in pending),
            cure="run `python -m soar models fetch` with a network",
        )  # fmt: skip
    if not pending:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".fetch.") as work:
            archives: dict[Archive, Path] = {}
            for model in pending:
                for archive in (source.archive for source in model.sources):
                    if archive not in archives:
                        archives[archive] = download(archive, Path(work) / str(len(archives)))
                _make(model, folder, archives, settings)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EPERM):
            raise StorageError(
                f"cannot fill {folder}: {error.strerror}", cure="free 2 GB, or make it writable"
            ) from error
        raise


def _installed(model: Model, folder: Path, settings: ModelsSettings) -> bool:
    """True if the file is there, made of the pinned sources by the present recipe."""
    record = records.read(folder, model.file)
    if (
        record is None
        or not (folder / model.file).is_file()
        or any(record.get(k) != v for k, v in _origin(model, settings).items())
    ):
        return False
    records.check(folder, model.file)
    return True


def _origin(model: Model, settings: ModelsSettings) -> dict[str, object]:
    """The part of a record that decides whether the file must be made again."""
    recipe = f"{model.recipe} {_RECIPES[model.recipe].version}"
    if model.recipe in ("anny", "anny_helpers"):
        recipe += " " + json.dumps(dataclasses.asdict(settings.anny), sort_keys=True)
    return {"recipe": recipe, "sources": [_source(source) for source in model.sources]}


def _source(source: Member) -> dict[str, str]:
    return {
        "package": source.archive.name,
        "version": source.archive.version,
        "member": source.path or "",
        "sha256": source.sha256 or source.archive.sha256,
    }


def _make(model: Model, folder: Path, archives: dict[Archive, Path], settings: ModelsSettings) -> None:
    with atomic_path(folder / model.file) as temporary:
        _RECIPES[model.recipe].make(model, archives, temporary, settings)
    records.write(folder, model.file, _origin(model, settings) | {"licence": model.licence, "feeds": model.feeds})


def _content(source: Member, archives: dict[Archive, Path]) -> bytes:
    """The checked bytes of a member."""
    if source.path is None or source.sha256 is None:
        raise ValueError(f"{source.archive} is used as a whole")
    content = member(archives[source.archive], source.path)
    cure = "the catalogue and the archive disagree: report this"
    verify_digest(f"{source.path} of {source.archive}", source.sha256, hashlib.sha256(content).hexdigest(), cure)
    return content


def _copy(model: Model, archives: dict[Archive, Path], out: Path, settings: ModelsSettings) -> None:
    out.write_bytes(_content(model.sources[0], archives))


def _onnx(model: Model, archives: dict[Archive, Path], out: Path, settings: ModelsSettings) -> None:
    out.write_bytes(convert.convert(_content(model.sources[0], archives), model.name))


def _lpips(model: Model, archives: dict[Archive, Path], out: Path, settings: ModelsSettings) -> None:
    write_tensors(out, lpips_weights.lpips_tensors(_content(model.sources[0], archives), model.name), {})


def _anny(model: Model, archives: dict[Archive, Path], out: Path, settings: ModelsSettings) -> None:
    anny_export.export([archives[source.archive] for source in model.sources], out, settings.anny)


def _anny_helpers(model: Model, archives: dict[Archive, Path], out: Path, settings: ModelsSettings) -> None:
    anny_export.export([archives[source.archive] for source in model.sources], out, settings.anny, "helpers")


@dataclasses.dataclass(frozen=True)
class _Recipe:
    version: str
    make: Callable[[Model, dict[Archive, Path], Path, ModelsSettings], None]


_RECIPES = {
    "copy": _Recipe("1", _copy),
    "onnx": _Recipe(convert.VERSION, _onnx),
    "lpips": _Recipe(lpips_weights.VERSION, _lpips),
    "anny": _Recipe(anny_export.VERSION, _anny),
    "anny_helpers": _Recipe(anny_export.HELPERS_VERSION, _anny_helpers),
}
