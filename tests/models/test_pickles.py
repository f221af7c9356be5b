"""Pickles of plain data come back as they were; those that would run, restore or allocate something do not."""

from __future__ import annotations

import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from soar.errors import ModelFileError
from soar.models.pickles import unpickle_arrays

TREE: dict[str, Any] = {
    "c": np.arange(12.0).reshape(3, 4),
    "fortran": np.asfortranarray(np.arange(24, dtype=np.float32).reshape(2, 3, 4)),
    "indices": np.array([1, 2, 2**32 - 1], np.uint32),
    "flags": np.array([True, False]),
    "big endian": np.arange(3, dtype=">i4"),
    "empty": np.zeros((0, 3)),
    "point": np.array(2.5),
    "texts": np.array(["neutral", "male"]),
    "scalar": np.float32(3.5),
    "nested": {"list": [1, "two", None], "tuple": (1.5, True)},
}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_round_trip(protocol: int) -> None:
    found = unpickle_arrays(pickle.dumps(TREE, protocol=protocol), "tree")
    assert found.keys() == TREE.keys()
    found["c"] += 0  # arrays can be written to
    for name, value in TREE.items():
        got = found[name]
        if isinstance(value, np.ndarray):
            assert (got.dtype, got.shape) == (value.dtype, value.shape), name
        assert type(got) is type(value)
        np.testing.assert_equal(got, value)


@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize("kind", [sparse.csc_matrix, sparse.csr_matrix])
def test_sparse_matrices_and_objects(protocol: int, kind: type) -> None:
    matrix = kind(np.diag([1.0, 0, 3]))
    table = np.array({"mean": np.ones(3)}, object)
    listed = np.array([[None, "a"], [np.zeros(2), 4]], object)
    content = pickle.dumps({"J": matrix, "table": table, "listed": listed}, protocol=protocol)
    found = unpickle_arrays(content, "tree")
    assert found["J"].format == matrix.format
    np.testing.assert_array_equal(found["J"].toarray(), matrix.toarray())
    np.testing.assert_array_equal(found["table"].item()["mean"], np.ones(3))
    assert found["listed"].shape == (2, 2)
    np.testing.assert_array_equal(found["listed"][1, 0], np.zeros(2))


def test_written_by_python_2() -> None:
    """Names of its modules, and content as text: float64 1.0 and 2.0."""
    content = (
        b"\x80\x02}U\x01acnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01K\x02\x85"
        b"cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x10"
        + np.array([1.0, 2.0]).tobytes()
        + b"tbs."
    )
    np.testing.assert_array_equal(unpickle_arrays(content, "old")["a"], [1.0, 2.0])


def test_shared_and_repeated_parts_take_no_time() -> None:
    tree: Any = np.ones(2)
    for _ in range(60):
        tree = [tree, tree]
    assert len(unpickle_arrays(pickle.dumps({"deep": tree}), "shared")["deep"]) == 2


# --- what does not come back -----------------------------------------------------------------------------------------


class Bomb:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_no_function_is_called(tmp_path: Path, protocol: int) -> None:
    content = pickle.dumps({"a": np.ones(3), "b": Bomb(tmp_path / "ran")}, protocol=protocol)
    with pytest.raises(ModelFileError, match="mkdir"):
        unpickle_arrays(content, "bomb", "write it again")
    assert not (tmp_path / "ran").exists()


ARRAY = b"cnumpy.core.multiarray\n_reconstruct\n"
FLOAT = b"(X\x02\x00\x00\x00f8tR"
HOSTILE = {
    "numpy's own allocation": b"cnumpy\nndarray\n(\x8a\x06\x00\x00\x00\x00\x00\x10tR.",
    "a shape without its bytes": ARRAY + b"(tR(K\x01\x8a\x06\x00\x00\x00\x00\x00\x10\x85cnumpy\ndtype\n" + FLOAT
    + b"\x89C\x08" + b"\x00" * 8 + b"tb.",
    "pointers as bytes": ARRAY + b"(tR(K\x01K\x01\x85cnumpy\ndtype\n(X\x01\x00\x00\x00OtR\x89C\x08" + b"\x41" * 8
    + b"tb.",
    "a structured type": b"cnumpy\ndtype\n(X\x02\x00\x00\x00V8tR.",
    "a type's own state": b"cnumpy\ndtype\n" + FLOAT + b"(K\x03X\x01\x00\x00\x00|NN}NNNtb.",
    "an altered stand-in": b"c_codecs\nencode\n(N}X\x0c\x00\x00\x00__defaults__)stb.",
    "a builtin": b"cbuiltins\neval\n(X\x03\x00\x00\x001+1tR.",
    "an attribute of an allowed name": b"\x80\x04\x8c\x05numpy\x8c\x0edtype.__init__\x93.",
    "a table of the unpickler": b"\x80\x02}r" + struct.pack("<I", 2**31) + b".",
    "itself": b"]q\x00h\x00a.",
    "an object": b"ccopy_reg\n_reconstructor\n(c__builtin__\nobject\nc__builtin__\nobject\nNtR.",
    "bytes that are not there": b"\x80\x05\x96" + struct.pack("<Q", 2**40) + b"xx.",
    "a number of too many digits": b"L" + b"9" * 10**5 + b"L\n.",
    "a type as a value": b"cnumpy\ndtype\n.",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile(name: str) -> None:
    wrapped = HOSTILE[name].removeprefix(b"\x80\x02").removeprefix(b"\x80\x04").removeprefix(b"\x80\x05")
    content = b"\x80\x05}X\x01\x00\x00\x00a" + wrapped[:-1] + b"s."
    with pytest.raises(ModelFileError, match="not a pickle of plain arrays"):
        unpickle_arrays(content, "hostile")


def test_sparse_indices_out_of_range() -> None:
    matrix = sparse.csc_matrix(np.eye(3))
    matrix.indices[1] = 10**6
    with pytest.raises(ModelFileError, match="not a pickle of plain arrays"):
        unpickle_arrays(pickle.dumps({"J": matrix}), "sparse")


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.99])
def test_truncated(part: float) -> None:
    content = pickle.dumps(TREE)
    with pytest.raises(ModelFileError, match="not a pickle of plain arrays") as caught:
        unpickle_arrays(content[: int(part * len(content))], "short", "download it again")
    assert caught.value.cure == "download it again"


def test_something_else_than_a_dict() -> None:
    with pytest.raises(ModelFileError, match="holds a ndarray"):
        unpickle_arrays(pickle.dumps(np.ones(3)), "array")
