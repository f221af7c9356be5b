"""Opening what users bring: arrays out of ``.npz``, JSON, pickles and torch files, with nothing in them ever run."""

from __future__ import annotations

import io
import json
import pickle
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from soar.errors import InputError, ModelFileError
from soar.models.pickles import unpickle_arrays

MAX_BYTES = 4 << 30
"""Largest content of one file, unpacked: hours of parameters are megabytes."""
CURE = "write it again with the tool that made it; check that body.format names that tool"


def unreadable(path: Path, why: object) -> NoReturn:
    """Raise that ``path`` cannot be read."""
    raise InputError(f"{path} cannot be read: {why}", cure=CURE)


def content(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: it is missing or too large.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            unreadable(path, f"it has more than {MAX_BYTES >> 30} GiB")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}", cure="correct body.source") from error


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz``; those that only a pickle can hold are left out.

    Raises:
        InputError: it is missing, damaged, or unpacks to too much.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MAX_BYTES:
                unreadable(path, f"it unpacks to more than {MAX_BYTES >> 30} GiB")
            return {
                entry.filename.removesuffix(".npy"): value
                for entry in archive.infolist()
                if entry.filename.endswith(".npy") and (value := _member(archive, entry)) is not None
            }
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing", cure="correct body.source") from error
    # What damaged archives and array headers end in.
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError, RuntimeError, MemoryError) as error:
        unreadable(path, error)


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray | None:
    """One array of plain numbers or texts; None for one of objects."""
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(stream)
        if dtype.hasobject:
            return None
        size = dtype.itemsize * int(np.prod(shape, dtype=object))
        if size > entry.file_size:
            raise ValueError(f"{entry.filename} promises {size} bytes and has {entry.file_size}")
    with archive.open(entry) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def read_json(path: Path) -> Any:
    """A JSON file; raises :class:`~soar.errors.InputError` if it is missing or damaged."""
    try:
        return json.loads(content(path).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        unreadable(path, error)


def read_pickle(path: Path) -> dict[str, Any]:
    """A pickle of a dict of arrays.

    Raises:
        InputError: it is missing, damaged, or refers to anything but plain data, which is never run.
    """
    try:
        return unpickle_arrays(content(path), str(path), CURE)
    except ModelFileError as error:
        raise InputError(error.what, expected=error.expected, got=error.got, cure=error.cure) from error


def read_torch(path: Path) -> dict[str, Any]:
    """A dict of tensors, as ``torch.save`` writes it; tensors come as arrays.

    Raises:
        InputError: it is missing, damaged, or holds more than tensors and plain data, which is never run.
    """
    import torch

    data = io.BytesIO(content(path))
    try:
        tree = torch.load(data, map_location="cpu", weights_only=True)
    # torch says of damaged files whatever the part that stumbles says.
    except (
        pickle.UnpicklingError, RuntimeError, EOFError, OSError, ValueError, KeyError, IndexError, TypeError,
        AttributeError, AssertionError, OverflowError, MemoryError, ImportError,
    ) as error:  # fmt: skip
        unreadable(path, str(error).split("\n")[0])

    def plain(value: Any) -> Any:
        if isinstance(value, torch.Tensor):
            return value.detach().double().numpy()
        return {k: plain(v) for k, v in value.items()} if isinstance(value, Mapping) else value

    if not isinstance(tree, Mapping):
        unreadable(path, f"it holds a {type(tree).__name__} instead of a dict")
    return plain(tree)  # type: ignore[no-any-return]


def array(table: Any, key: Any, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """One entry as finite float64 numbers of ``shape``, in which -1 stands for any size.

    Raises:
        InputError: the entry is missing, holds no numbers, or does not fit the shape.
    """
    if not isinstance(table, Mapping) or key not in table:
        got = ", ".join(map(str, table))[:400] if isinstance(table, Mapping) else type(table).__name__
        raise InputError(f"{path} lacks {key}", got=got, cure=CURE)
    try:
        value = np.asarray(table[key], np.float64)
        value = value.reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        got = str(getattr(table[key], "shape", type(table[key]).__name__))
        raise InputError(f"{path}: {key} is malformed", expected=f"numbers {shape}", got=got, cure=CURE) from error
    if not np.isfinite(value).all():
        raise InputError(f"{path}: {key} holds NaN or infinity", expected="finite numbers", cure=CURE)
    return value


def rotations(table: Any, key: Any, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """One entry as rotation matrices of ``shape`` (..., 3, 3).

    Raises:
        InputError: as :func:`array`, or a matrix is no rotation.
    """
    value = array(table, key, shape, path)
    _orthonormal(value, key, path)
    return value


def rigid(table: Any, key: Any, path: Path) -> np.ndarray:
    """One entry as a (4, 4) rigid transform; raises :class:`~soar.errors.InputError` as :func:`rotations` does."""
    value = array(table, key, (4, 4), path)
    _orthonormal(value[:3, :3], key, path)
    return value


def _orthonormal(R: np.ndarray, key: Any, path: Path) -> None:
    if R.size and (np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max() > 1e-2 or np.linalg.det(R).min() < 0):
        raise InputError(f"{path}: {key} holds no rotations", expected="orthonormal rows, determinant +1", cure=CURE)


def entry(table: Any, key: Any, kind: type, path: Path) -> Any:
    """One entry of a type; raises :class:`~soar.errors.InputError` if it is missing or another."""
    value = table.get(key) if isinstance(table, Mapping) else None
    if not isinstance(value, kind):
        raise InputError(f"{path}: {key} is malformed", expected=kind.__name__, got=type(value).__name__, cure=CURE)
    return value


def resolve(path: Path, *names: str) -> Path:
    """``path`` itself if it is a file, else the first of ``names`` that is below it.

    Raises:
        InputError: there is none.
    """
    if path.is_file():
        return path
    for name in names:
        if (path / name).is_file():
            return path / name
    raise InputError(
        f"{path} has none of the files of this format", expected=" or ".join(names), cure="correct body.source"
    )


def last_number(name: str, path: Path) -> int:
    """The last number in a name; raises :class:`~soar.errors.InputError` if there is none."""
    numbers = re.findall(r"\d+", name)
    if not numbers or len(numbers[-1]) > 12:
        raise InputError(f"{path}: no frame number in {name!r}", expected="a name such as 000012", cure=CURE)
    return int(numbers[-1])
