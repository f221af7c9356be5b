"""Pickles as ``joblib.dump`` writes them: an array's bytes follow its description inside the stream.

They are read as :mod:`soar.models.pickles` reads others, with stand-ins for what a pickle names, so nothing of the
file's choosing is called. joblib's own stand-in for arrays, its ``NumpyArrayWrapper``, is one more.
"""

from __future__ import annotations

import io
import pickle
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from soar.importers.files import MAX_BYTES, content, unreadable
from soar.models.pickles import STAND_INS, array_of, plain

_COMPRESSED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\xfd7zXZ": "xz", b"]\x00\x00": "lzma", b"\x04\x22M\x18": "lz4"}
_ZLIB = (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda")


def read_joblib(path: Path) -> Any:
    """What a joblib file holds: dicts, lists, numbers, texts and arrays.

    Raises:
        InputError: it is missing, damaged, compressed otherwise than by zlib, or refers to anything but plain data,
            which is never run.
    """
    data = content(path)
    for magic, name in _COMPRESSED.items():
        if data.startswith(magic):
            unreadable(path, f"it is compressed by {name}; write it with joblib.dump(..., compress=3), which is zlib")
    try:
        return plain(_Reader(_inflated(data) if data.startswith(_ZLIB) else data).load(), {})
    # Damaged pickles fail in any of these ways, by the documentation of the pickle module.
    except (
        pickle.UnpicklingError, EOFError, AttributeError, IndexError, ValueError, TypeError, KeyError, OverflowError,
        RecursionError, MemoryError, struct.error, zlib.error, AssertionError,
    ) as error:  # fmt: skip
        unreadable(path, error)


def _inflated(data: bytes) -> bytes:
    inflate = zlib.decompressobj()
    out = inflate.decompress(data, MAX_BYTES)
    if not inflate.eof:
        raise ValueError("it is truncated, or unpacks to too much")
    return out


class _Wrapper:
    """Stands for ``NumpyArrayWrapper``: what array follows in the stream."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.shape, self.order, self.kind = state["shape"], state["order"], state["dtype"]
        self.padded = state.get("numpy_array_alignment_bytes") is not None

    def read(self, stream: io.BytesIO) -> np.ndarray:
        """The array at the stream's place."""
        if self.padded:
            stream.read(stream.read(1)[0])
        kind = self.kind.dtype
        if kind.hasobject:
            raise ValueError("an array of objects")
        size = kind.itemsize * int(np.prod(self.shape, dtype=object))
        return array_of(stream.read(size), self.kind, self.shape, self.order)


_Unpickler: Any = pickle._Unpickler  # type: ignore[attr-defined]  # the one in Python can be taught where arrays lie


class _Reader(_Unpickler):
    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = dict(_Unpickler.dispatch)

    def __init__(self, data: bytes) -> None:
        self._stream = io.BytesIO(data)
        super().__init__(self._stream, encoding="latin1")

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _KNOWN[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"refers to {module}.{name}") from None

    def load_build(self) -> None:
        if type(self.stack[-2]) not in _KNOWN.values():  # a class or function of ours would keep what it is given
            raise pickle.UnpicklingError(f"sets the state of a {type(self.stack[-2]).__name__}")
        super().load_build()
        if isinstance(self.stack[-1], _Wrapper):
            self.stack[-1] = self.stack[-1].read(self._stream)

    dispatch[pickle.BUILD[0]] = load_build


def _dict(*factory: Any) -> dict[Any, Any]:
    """A defaultdict is read as a dict."""
    return {}


_KNOWN = STAND_INS | {
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _Wrapper,
    ("collections", "defaultdict"): _dict,
    ("collections", "OrderedDict"): _dict,
    ("builtins", "dict"): "dict",
    ("__builtin__", "dict"): "dict",  # in the protocols of Python 2
}
