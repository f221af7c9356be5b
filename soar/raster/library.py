"""Finds or builds the native library once per process, and says loudly when there is none."""

from __future__ import annotations

import ctypes
import functools
import warnings
from ctypes import c_float, c_int, c_int64, c_void_p
from pathlib import Path

from torch import Tensor

from soar.errors import ConfigError
from soar.raster import build
from soar.raster.types import Backend

_SIGNATURES = {
    "soar_supported": (c_int, []),
    "soar_surfels_forward": (
        c_void_p,
        [c_void_p] * 5 + [c_int64, c_void_p, c_int, c_int, c_float, c_int, c_int, c_void_p, c_void_p, c_int],
    ),
    "soar_surfels_backward": (c_int, [c_void_p] * 6 + [c_int64] + [c_void_p] * 9 + [c_int]),
    "soar_surfels_release": (None, [c_void_p]),
    "soar_mesh": (
        c_int,
        [c_void_p, c_int64, c_void_p, c_int64, c_void_p, c_int, c_int, c_int, c_void_p, c_void_p, c_void_p, c_int],
    ),
    "soar_hash_forward": (c_int, [c_void_p, c_int64, c_void_p, c_int, c_int64] + [c_void_p] * 2 + [c_int]),
    "soar_hash_backward": (c_int, [c_void_p, c_int64, c_void_p, c_int, c_int64] + [c_void_p] * 4 + [c_int]),
}


def _open(path: Path) -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise build.BuildError(f"{path} cannot be loaded ({error}); delete it, and it is built again") from error
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    if not library.soar_supported():
        raise build.BuildError("this processor lacks AVX2 or FMA, which the native rasteriser is compiled for")
    return library


@functools.cache
def _load() -> ctypes.CDLL | build.BuildError:
    try:
        if build.installed_path().exists():
            return _open(build.installed_path())
        command = build.compiler()
        path = build.cached_path(command)
        if not path.exists():
            build.compile_library(command, path)
        return _open(path)
    except build.BuildError as error:
        return error


def has_native() -> bool:
    """Whether the native library is there, was buildable, and runs on this processor."""
    return not isinstance(_load(), build.BuildError)


def library() -> ctypes.CDLL:
    """The native library.

    Raises:
        ConfigError: there is none; the message says why and what to do.
    """
    found = _load()
    if isinstance(found, build.BuildError):
        raise ConfigError("there is no native rasteriser", got=str(found), cure="or choose raster.backend=reference")
    return found


@functools.cache
def _warn() -> None:
    warnings.warn(
        f"SOAR renders with the slow reference rasteriser, 20 to 90 times slower than the native one: {_load()}",
        RuntimeWarning,
        stacklevel=4,
    )


def choose(backend: Backend, *tensors: Tensor) -> Backend:
    """Resolve ``auto``. The native kernels take float32 on the CPU; anything else is the reference's.

    Raises:
        ConfigError: ``native`` was asked for and cannot be had.
    """
    fits = all(t.device.type == "cpu" and (t.dtype.itemsize == 4 or not t.is_floating_point()) for t in tensors)
    if backend == "native":
        if not fits:
            raise ConfigError(
                "the native rasteriser takes float32 tensors in main memory",
                got=", ".join(f"{t.dtype} on {t.device}" for t in tensors),
                cure="convert them, or choose raster.backend=auto",
            )
        library()
        return "native"
    if backend == "reference" or not fits:
        return "reference"
    if has_native():
        return "native"
    _warn()
    return "reference"
