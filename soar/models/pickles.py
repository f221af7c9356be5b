"""Pickles of plain data, read without letting one run code.

A pickle is a program that names functions and calls them. The few that arrays are made with are played by stand-ins,
which only keep what they are given; whatever else a pickle names ends the reading. So nothing of the file's choosing
is called, arrays are no larger than the file has bytes for, and numpy never restores itself from a state it is handed.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from soar.errors import ModelFileError

_EXPECTED = "dicts and lists of numbers, texts, numpy arrays and scipy sparse matrices"
_PLAIN = re.compile(r"[<>|=]?(\?|[biufc]\d{0,2}|[SU]\d{1,6}|O8?)")
_MEMO = 1 << 20  # the unpickler keeps a table as long as the largest number of a memo entry


def unpickle_arrays(content: bytes, name: str, cure: str = "fetch it again") -> dict[str, Any]:
    """What a pickle of a dict holds, written by Python 2 or 3; sparse matrices come as scipy's own.

    Args:
        content: the pickle.
        name: of the file, for messages.
        cure: what to do about one that cannot be read.

    Raises:
        ModelFileError: the pickle is damaged, or refers to anything but arrays.
    """
    try:
        for operation, argument, _ in pickletools.genops(content):  # reads what it says it reads, or fails
            if operation.name in ("PUT", "LONG_BINPUT") and int(argument or 0) > _MEMO:
                raise pickle.UnpicklingError(f"memo entry {argument}")
        tree = plain(_Reader(io.BytesIO(content), encoding="latin1").load(), {})
    # Damaged pickles fail in any of these ways, by the documentation of the pickle module.
    except (
        pickle.UnpicklingError, EOFError, AttributeError, IndexError, ValueError, TypeError, KeyError, OverflowError,
        RecursionError, MemoryError, struct.error,
    ) as error:  # fmt: skip
        raise ModelFileError(
            f"{name} is not a pickle of plain arrays: {error}", expected=_EXPECTED, cure=cure
        ) from error
    if not isinstance(tree, dict):
        raise ModelFileError(f"{name} holds a {type(tree).__name__}", expected="a dict of arrays", cure=cure)
    return tree


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return STAND_INS[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"refers to {module}.{name}") from None


class _Call:
    """Stands for a function."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise pickle.UnpicklingError("alters a function")


class _Dtype:
    """Stands for a dtype of plain numbers, texts or objects."""

    def __init__(self, code: str, align: bool = False, copy: bool = False) -> None:
        if not _PLAIN.fullmatch(code):
            raise ValueError(f"holds items of type {code!r}")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        order, subtype, names, fields = state[1:5]
        if order not in ("<", ">", "|", "=") or any(part is not None for part in (subtype, names, fields)):
            raise ValueError("holds structured items")
        self.dtype = self.dtype.newbyteorder(order)


class _Array:
    """Stands for an array until its content comes; what it is made with is a placeholder of numpy's."""

    value: Any = None

    def __init__(self, *placeholder: Any) -> None:
        pass

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        shape, kind, fortran, data = state[-4:]
        self.value = array_of(data, kind, shape, "F" if fortran else "C")


class _Sparse:
    """Stands for a compressed sparse matrix."""

    kind = ""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.state = state


class _Csc(_Sparse):
    kind = "csc_matrix"


class _Csr(_Sparse):
    kind = "csr_matrix"


def array_of(data: Any, kind: _Dtype, shape: tuple[int, ...], order: Any = "C") -> Any:
    """An array of ``shape`` from its bytes, or from the list of its objects."""
    if kind.dtype.hasobject:
        return np.array([*data, None], object)[:-1].reshape(shape, order=order)
    raw = data.encode("latin1") if isinstance(data, str) else data
    return np.frombuffer(raw, kind.dtype).copy().reshape(shape, order=order)


def _scalar(kind: _Dtype, data: Any) -> Any:
    return array_of(data, kind, ())[()]


def _encode(text: str, encoding: str) -> bytes:
    """How Python 3 writes bytes in the protocols of Python 2."""
    if encoding != "latin1":
        raise ValueError(f"bytes as {encoding}")
    return text.encode("latin1")


def _reconstructor(kind: type, base: Any, state: Any) -> Any:
    """How the oldest protocols make an object."""
    if not (isinstance(kind, type) and issubclass(kind, _Sparse)):
        raise ValueError("makes an object")
    return kind()


STAND_INS: dict[tuple[str, str], Any] = {
    ("numpy", "dtype"): _Dtype,
    ("numpy", "ndarray"): "ndarray",
    ("_codecs", "encode"): _Call(_encode),
    ("__builtin__", "bytes"): _Call(lambda: b""),  # how Python 3 writes none of them in the protocols of Python 2
}
for _builtins, _copyreg in (("__builtin__", "copy_reg"), ("builtins", "copyreg")):  # Python 2, and 3
    STAND_INS[_builtins, "object"] = "object"
    STAND_INS[_copyreg, "_reconstructor"] = _Call(_reconstructor)
for _core in ("numpy.core", "numpy._core"):  # before numpy 2, and since
    STAND_INS[f"{_core}.multiarray", "_reconstruct"] = _Array
    STAND_INS[f"{_core}.multiarray", "scalar"] = _Call(_scalar)
    STAND_INS[f"{_core}.numeric", "_frombuffer"] = _Call(array_of)
for _kind, _stand_in in (("csc", _Csc), ("csr", _Csr)):  # before scipy 1.8, and since
    STAND_INS[f"scipy.sparse.{_kind}", f"{_kind}_matrix"] = _stand_in
    STAND_INS[f"scipy.sparse._{_kind}", f"{_kind}_matrix"] = _stand_in


def plain(value: Any, seen: dict[int, Any]) -> Any:
    """The same tree with what the stand-ins stand for; ``seen`` holds what is done already, by identity."""
    if id(value) in seen:
        return seen[id(value)]
    out = value
    if isinstance(value, dict):
        out = {plain(k, seen): plain(v, seen) for k, v in value.items()}
    elif isinstance(value, (list, tuple)):
        out = type(value)(plain(v, seen) for v in value)
    elif isinstance(value, _Array):
        out = plain(value.value, seen)
    elif isinstance(value, np.ndarray) and value.dtype.hasobject:
        out = np.array([*(plain(v, seen) for v in value.flat), None], object)[:-1].reshape(value.shape)
    elif isinstance(value, _Sparse):
        out = _sparse(value.kind, plain(value.state, seen))
    elif isinstance(value, _Dtype) or callable(value):
        raise ValueError("holds a type or a function where a value should be")
    seen[id(value)] = out
    return out


def _sparse(kind: str, state: dict[str, Any]) -> Any:
    from scipy import sparse

    shape = state["_shape"] if "_shape" in state else state["shape"]
    matrix = getattr(sparse, kind)(tuple(state[key] for key in ("data", "indices", "indptr")), shape)
    matrix.check_format(full_check=True)  # numbers out of range would be written beyond a dense matrix
    return matrix
