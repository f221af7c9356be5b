"""Reading one normal map that another program wrote: a picture, or arrays of numpy."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from pathlib import Path
from typing import IO

import cv2
import numpy as np

from soar.errors import InputError
from soar.perception.normal_maps import unit

SUFFIXES = (".png", ".npz", ".npy")

MAX_PIXELS = 1 << 26
"""Largest map that is read, 8192 x 8192: sizes in a file's header cost memory before its content shows them wrong."""

_LENGTHS = (0.5, 1.4)  # of what is a normal; black, white and grey backgrounds are 1.7, 1.7 and 0 long
_CURE = "write maps as 8 or 16 bit PNG of (n + 1) / 2, or as numpy arrays (H, W, 3) of n; see docs/normals.md"


def arrays_in(path: Path) -> list[str]:
    """Names of the arrays of an ``.npz``; of other files none.

    Raises:
        InputError: it is no archive.
    """
    if path.suffix.lower() != ".npz":
        return []
    try:
        with zipfile.ZipFile(path) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path} cannot be read: {error}", cure=_CURE) from error


def read_map(path: Path, name: str | None = None) -> np.ndarray:
    """The unit normals (H, W, 3) float32 of a file in the axes of who wrote it; zero where it shows none.

    A pixel without a normal is transparent, or stands for a vector far from unit length. Whole numbers are (n + 1) / 2
    of their type's range, those with a sign n itself; so are floating-point numbers. Arrays may also be (3, H, W) or
    (1, 3, H, W).

    Args:
        path: ``.png``, ``.npy`` or ``.npz``.
        name: of the array in an ``.npz``.

    Raises:
        InputError: the file is damaged, too large, no map of vectors, or cannot be read without running what is in it.
    """
    values = _picture(path) if path.suffix.lower() == ".png" else _array(path, name)
    opaque = np.True_
    if values.shape[-1] == 4:
        values, opaque = values[..., :3], values[..., 3] > np.iinfo(values.dtype).max // 2
    if values.dtype.kind == "u":
        normals = values.astype(np.float32) * np.float32(2 / np.iinfo(values.dtype).max) - 1
    elif values.dtype.kind == "i":
        normals = values.astype(np.float32) / np.iinfo(values.dtype).max
    else:
        normals = np.nan_to_num(values.astype(np.float32), nan=0, posinf=9, neginf=9)
    length = np.linalg.norm(normals, axis=-1)
    there = opaque & (length > _LENGTHS[0]) & (length < _LENGTHS[1])
    if not there.any():
        raise InputError(f"{path} holds no normals", expected="vectors of length 1", got=_spread(length), cure=_CURE)
    return np.where(there[..., None], unit(normals), np.float32(0))


def _spread(length: np.ndarray) -> str:
    return f"lengths from {length.min():.2f} to {length.max():.2f}"


def _picture(path: Path) -> np.ndarray:
    """(H, W, 3) RGB or (H, W, 4) RGBA, uint8 or uint16."""
    try:
        content = path.read_bytes()
        width, height = struct.unpack_from(">II", content, 16)
        if content[:8] != b"\x89PNG\r\n\x1a\n" or not 0 < width * height <= MAX_PIXELS:
            raise ValueError(f"no PNG of at most {MAX_PIXELS} pixels")
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, ValueError, struct.error, cv2.error) as error:
        raise InputError(f"{path} cannot be read: {error}", cure=_CURE) from error
    if image is None or image.ndim != 3:
        got = "no picture" if image is None else "one channel"
        raise InputError(f"{path} is no normal map", expected="a PNG with colours", got=got, cure=_CURE)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def _array(path: Path, name: str | None) -> np.ndarray:
    """(H, W, 3) numbers."""
    try:
        with _stream(path, name) as stream:
            version = np.lib.format.read_magic(stream)
            header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = header(stream)
            if dtype.kind not in "uif" or math.prod(shape) > 4 * MAX_PIXELS:
                raise ValueError(f"an array {shape} of {dtype}, not numbers of at most {MAX_PIXELS} pixels")
        with _stream(path, name) as stream:
            values = np.lib.format.read_array(stream, allow_pickle=False)
    # What damaged archives and array headers end in.
    except (
        OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError,
        MemoryError, TypeError,
    ) as error:  # fmt: skip
        raise InputError(f"{path} cannot be read: {error}", cure=_CURE) from error
    values = values[0] if values.ndim == 4 and values.shape[0] == 1 else values
    values = values.transpose(1, 2, 0) if values.ndim == 3 and values.shape[0] == 3 != values.shape[-1] else values
    if values.ndim != 3 or values.shape[-1] != 3 or not values.size:
        raise InputError(f"{path} is no normal map", expected="an array (H, W, 3)", got=str(values.shape), cure=_CURE)
    return values


def _stream(path: Path, name: str | None) -> IO[bytes]:
    return path.open("rb") if name is None else zipfile.ZipFile(path).open(f"{name}.npy")
