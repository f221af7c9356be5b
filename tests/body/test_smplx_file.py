"""Model files: both versions and forms are read, every defect is named, and nothing in them runs."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from soar.body.smplx_file import FACES, VERTICES, SmplxFile, read_smplx
from soar.errors import ModelFileError
from tests.body import official


@pytest.fixture(scope="module")
def content() -> dict[str, np.ndarray]:
    """A version 1.0 model, small numbers and all."""
    return official.arrays(20, dtype=np.float32)


@pytest.fixture
def folder(tmp_path: Path):
    """A folder that leaves nothing: the files are large."""
    yield tmp_path
    for path in tmp_path.iterdir():
        path.unlink()


def same(file: SmplxFile, content: dict[str, np.ndarray], shapes: int) -> None:
    np.testing.assert_array_equal(file.shapedirs, content["shapedirs"][..., :shapes])
    np.testing.assert_array_equal(file.exprdirs, content["shapedirs"][..., shapes:])
    np.testing.assert_array_equal(file.faces, content["f"])
    assert file.faces.dtype == np.int64
    np.testing.assert_allclose(file.J_regressor, content["J_regressor"])
    np.testing.assert_array_equal(file.hand_mean[1], content["hands_meanr"])
    np.testing.assert_array_equal(file.contour_faces, content["dynamic_lmk_faces_idx"])


def test_npz_of_version_1_0(content: dict[str, np.ndarray], folder: Path) -> None:
    file = read_smplx(official.write(folder / "SMPLX_NEUTRAL.npz", content))
    same(file, content, 10)
    assert file.exprdirs.shape == (VERTICES, 3, 10)


def test_npz_of_version_1_1_splits_after_300(content: dict[str, np.ndarray], folder: Path) -> None:
    dirs = np.zeros((VERTICES, 3, 400), np.float32)
    dirs[:, :, :] = np.arange(400)
    file = read_smplx(official.write(folder / "SMPLX_MALE.npz", content | {"shapedirs": dirs}))
    assert file.shapedirs.shape[-1] == 300
    assert file.exprdirs[0, 0].tolist() == list(range(300, 400))


@pytest.mark.parametrize("protocol", [2, 4])
def test_pickle_with_a_sparse_regressor(content: dict[str, np.ndarray], folder: Path, protocol: int) -> None:
    path = folder / "SMPLX_FEMALE.pkl"
    tree = content | {"J_regressor": sparse.csc_matrix(content["J_regressor"]), "joint2num": {"pelvis": 0}}
    path.write_bytes(pickle.dumps(tree, protocol=protocol))
    same(read_smplx(path), content, 10)


def test_big_endian_numbers_are_turned(content: dict[str, np.ndarray], folder: Path) -> None:
    turned = {"v_template": content["v_template"].astype(">f8"), "weights": content["weights"].astype(">f4")}
    file = read_smplx(official.write(folder / "SMPLX_NEUTRAL.npz", content | turned))
    assert file.v_template.dtype.isnative
    np.testing.assert_array_equal(file.v_template, turned["v_template"])


def nan(value: np.ndarray) -> np.ndarray:
    out = value.copy()
    out.flat[7] = np.nan
    return out


def another_parent(value: np.ndarray) -> np.ndarray:
    out = value.copy()
    out[0, 30] = 3
    return out


DEFECTS: list[tuple[str, Callable[[np.ndarray], Any], str]] = [
    ("v_template", lambda x: x[:6890], r"v_template has the wrong shape\s+expected: \(10475, 3\)\s+got: +\(6890, 3\)"),
    ("shapedirs", lambda x: x[..., :16], r"shapedirs has the wrong shape\s+expected: .* or .*400"),
    ("posedirs", lambda x: x[..., :207], "posedirs has the wrong shape"),
    ("hands_meanl", lambda x: x.reshape(15, 3), "hands_meanl has the wrong shape"),
    ("J_regressor", nan, "J_regressor holds NaN"),
    ("weights", lambda x: x * 1.01, "weights do not sum to one"),
    ("lmk_bary_coords", lambda x: x + 0.1, "lmk_bary_coords do not sum to one"),
    ("f", lambda x: x + np.uint32(1), r"f is out of range\s+expected: 0 to 10474\s+got: .* to 10475"),
    ("lmk_faces_idx", lambda x: x - FACES, "lmk_faces_idx is out of range"),
    ("dynamic_lmk_faces_idx", lambda x: x + 0.5, "dynamic_lmk_faces_idx holds no indices"),
    ("kintree_table", another_parent, r"joint 30 hangs elsewhere\s+expected: parent 29\s+got: +parent 3"),
    ("v_template", lambda x: x.astype(str), "v_template is not of numbers"),
    ("weights", lambda x: np.ones_like(x, np.int64), "weights is not of numbers"),
]


@pytest.mark.parametrize(("key", "change", "message"), DEFECTS, ids=[f"{d[0]}-{i}" for i, d in enumerate(DEFECTS)])
def test_a_defect_is_named(
    content: dict[str, np.ndarray], folder: Path, key: str, change: Callable[[np.ndarray], Any], message: str
) -> None:
    # Stored apart, so that not all of it is written again for each defect.
    path = official.write(folder / "SMPLX_NEUTRAL.npz", light(content) | {key: change(content[key])})
    with pytest.raises(ModelFileError, match=message) as caught:
        read_smplx(path)
    assert caught.value.cure


def light(content: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same with the pose blend shapes in half precision."""
    return content | {"posedirs": content["posedirs"].astype(np.float16)}


def test_missing_arrays_are_listed(content: dict[str, np.ndarray], folder: Path) -> None:
    """As in a file of SMPL, which has no hands."""
    kept = {key: value for key, value in content.items() if "hands" not in key and key != "posedirs"}
    for path in (official.write(folder / "SMPL_NEUTRAL.npz", kept), folder / "SMPL_NEUTRAL.pkl"):
        if path.suffix == ".pkl":
            path.write_bytes(pickle.dumps(kept))
        with pytest.raises(ModelFileError, match="no posedirs, hands_componentsl, hands_componentsr") as caught:
            read_smplx(path)
        assert "MANO" in caught.value.cure


@pytest.mark.parametrize("name", ["nothing.npz", "."])
def test_no_file(folder: Path, name: str) -> None:
    with pytest.raises(ModelFileError, match="is no SMPL-X model file"):
        read_smplx(folder / name)


def test_other_suffix(folder: Path) -> None:
    (folder / "SMPLX.obj").write_text("v 0 0 0")
    with pytest.raises(ModelFileError, match=r"\.npz or \.pkl"):
        read_smplx(folder / "SMPLX.obj")


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
@pytest.mark.parametrize("keep", [0, 100, 0.5, -10])
def test_truncated(content: dict[str, np.ndarray], folder: Path, suffix: str, keep: float) -> None:
    path = folder / f"SMPLX_NEUTRAL{suffix}"
    small = {key: value for key, value in content.items() if value.size < 1e5}
    if suffix == ".npz":
        official.write(path, small)
    else:
        path.write_bytes(pickle.dumps(small, protocol=2))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole)) if 0 < keep < 1 else int(keep)])
    with pytest.raises(ModelFileError, match=r"cannot be read|not a pickle of plain arrays"):
        read_smplx(path)


def test_altered_bytes_fail_the_archive_s_checksum(content: dict[str, np.ndarray], folder: Path) -> None:
    path = official.write(folder / "SMPLX_NEUTRAL.npz", light(content))
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 3] ^= 0xFF
    path.write_bytes(damaged)
    with pytest.raises(ModelFileError, match="cannot be read"):
        read_smplx(path)


# --- nothing runs, and no room is made for what is not there ---------------------------------------------------------


class Bomb:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def test_code_is_refused_and_not_run(content: dict[str, np.ndarray], folder: Path) -> None:
    ran = folder / "ran"
    path = folder / "SMPLX_NEUTRAL.pkl"
    path.write_bytes(pickle.dumps({"v_template": content["v_template"], "f": Bomb(ran)}))
    with pytest.raises(ModelFileError, match="mkdir"):
        read_smplx(path)
    objects = np.empty((VERTICES, 3), object)
    objects[:] = Bomb(ran)
    for key in ("v_template", "joint2num"):  # looked at, and not
        npz = folder / "SMPLX_NEUTRAL.npz"
        np.savez(npz, **(light(content) | {key: objects}))
        if key == "v_template":
            with pytest.raises(ModelFileError, match="v_template is not of numbers"):
                read_smplx(npz)
        else:
            read_smplx(npz)
    assert not ran.exists()


def test_objects_of_other_packages_are_named_with_a_cure(folder: Path) -> None:
    path = folder / "SMPLX_NEUTRAL.pkl"
    path.write_bytes(b"cchumpy.ch\nCh\n.")
    with pytest.raises(ModelFileError, match=r"refers to chumpy\.ch\.Ch") as caught:
        read_smplx(path)
    assert ".npz" in caught.value.cure


def promise(path: Path, key: str, shape: tuple[int, ...], descr: str = "<f8") -> None:
    """An archive with an array that says it is of ``shape``, and holds nothing."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"{key}.npy", header.getvalue())


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((VERTICES, 3, 10**12), "posedirs has the wrong shape"),
        ((-1, 3, 486), "posedirs has the wrong shape"),
        ((VERTICES, 3, 486), "cannot be read"),  # what it should be, without the bytes
    ],
)
def test_promises_are_not_believed(
    content: dict[str, np.ndarray], folder: Path, shape: tuple[int, ...], message: str
) -> None:
    path = folder / "SMPLX_NEUTRAL.npz"
    np.savez(path, **{key: value for key, value in content.items() if key != "posedirs"})
    promise(path, "posedirs", shape)
    with pytest.raises(ModelFileError, match=message):
        read_smplx(path)


def test_headers_of_another_version_are_refused(content: dict[str, np.ndarray], folder: Path) -> None:
    """Their length may be four gigabytes."""
    path = folder / "SMPLX_NEUTRAL.npz"
    np.savez(path, **{key: value for key, value in content.items() if key != "v_template"})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("v_template.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + b" " * 64)
    with pytest.raises(ModelFileError, match=r"version \(2, 0\)"):
        read_smplx(path)


def test_a_pickle_beyond_all_size_is_not_opened(folder: Path) -> None:
    path = folder / "SMPLX_NEUTRAL.pkl"
    with path.open("wb") as stream:
        stream.truncate(3 << 30)  # a hole, no blocks
    with pytest.raises(ModelFileError, match="too large"):
        read_smplx(path)
