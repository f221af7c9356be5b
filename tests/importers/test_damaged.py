"""Files that are damaged, of another kind, or made to run code: a named error, and nothing is run."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from soar.body.parameters import HandSpace
from soar.errors import InputError
from soar.importers.archive import Known
from soar.importers.files import read_arrays
from soar.importers.joblib_file import read_joblib
from soar.importers.registry import read_parameters
from tests.importers import person, writers

MODEL = person.body()
HANDS = HandSpace.of(MODEL)
SIZE = (640, 480)
KINDS = [*sorted(writers.WRITERS), "amass"]


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder of every format, three frames each."""
    root, found, what = tmp_path_factory.mktemp("intact"), {}, person.truth(3)
    for kind, write in writers.WRITERS.items():
        more = {"pelvis": np.zeros(3)} if kind == "easymocap" else {}
        found[kind] = write(root / kind, what, person.camera(900.0, SIZE), HANDS, **more)
    (root / "amass").mkdir()
    found["amass"] = writers.amass(root / "amass/motion.npz", what).parent
    return found


@pytest.fixture
def copies(intact: dict[str, Path], tmp_path: Path) -> Callable[[str], Path]:
    def copy(kind: str) -> Path:
        return Path(shutil.copytree(intact[kind], tmp_path / kind))

    return copy


def read(kind: str, folder: Path) -> None:
    path = folder / "motion.npz" if kind == "amass" else folder
    read_parameters(kind, path, Known(SIZE, None, HANDS))


def files(folder: Path) -> list[Path]:
    """One file of each suffix and role."""
    roles = {
        (file.suffix, file.parent.name if file.suffix in (".npz", ".json") else "", file.stem[:3]): file
        for file in folder.rglob("*")
        if file.is_file()
    }
    return sorted(roles.values())


class Runs:
    """A pickle of this runs a command."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch '{self.marker}'",)


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def pth(tree: Any) -> bytes:
    stream = io.BytesIO()
    torch.save(tree, stream)
    return stream.getvalue()


@pytest.mark.parametrize("kind", KINDS)
def test_intact_files_are_read(intact: dict[str, Path], kind: str) -> None:
    read(kind, intact[kind])


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_named(copies: Callable[[str], Path], kind: str, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    folder = copies(kind)
    evil = Runs(marker)
    for file in files(folder):
        whole = file.read_bytes()
        pickled = [pickle.dumps(evil), pickle.dumps({"pose": evil}, 2), writers.joblib_dumps({0: {"pose": evil}})]
        made_to_run = [*pickled, zlib.compress(pickled[2]), pth({"Ks": evil}), npz(poses=np.array([evil], object))]
        others = [b"", b"{", b"[" * 100_000, b"PK\x05\x06" + bytes(18), npz(a=np.zeros(3)), pth({"a": torch.zeros(3)})]
        cut = [whole[: len(whole) * k // 7] for k in range(1, 7)]
        for content in [*cut, *others, *made_to_run]:
            file.write_bytes(content)
            with pytest.raises(InputError) as caught:
                read(kind, folder)
            assert str(folder) in str(caught.value)
            assert caught.value.cure
        file.write_bytes(whole)
    read(kind, folder)
    assert not marker.exists()
    # A marker would have been made, had one of them been read as pickles usually are.
    pickle.loads(pickle.dumps(evil))
    assert marker.exists()


def _tampered(file: Path, change: Callable[[dict[Any, Any]], None]) -> bytes:
    """The file with its table of arrays changed."""
    if file.suffix == ".npz":
        table = dict(np.load(file))
        change(table)
        return npz(**table)
    if file.suffix == ".json":
        value = json.loads(file.read_text())
        change(value[0] if isinstance(value, list) else value)
        return json.dumps(value).encode()
    if file.suffix in (".pt", ".pth"):
        table = torch.load(file)
        change(table.get("smpl_params_incam", table))
        return pth(table)
    raw = file.read_bytes()
    if raw.startswith(b"\x78"):
        tree = read_joblib(file)
        change(next(iter(tree.values())))
        return zlib.compress(writers.joblib_dumps(tree))
    if file.parent.name.startswith("img"):
        table = pickle.loads(raw)
        change(table)
        return pickle.dumps(table)
    tree = read_joblib(file)
    change(next(iter(tree.values())))
    return writers.joblib_dumps(tree)


ESSENTIAL = {
    "smplerx": ("body_pose", "transl", "betas", "left_hand_pose"), "smplifyx": ("global_orient", "camera_rotation"),
    "easymocap": ("poses", "Rh", "Th", "shapes", "id"), "romp": ("transl", "global_orient"),
    "amass": ("poses", "trans"), "phalp": ("tid", "smpl", "camera", "time"), "wham": ("pose", "trans", "frame_ids"),
    "gvhmr": ("body_pose", "transl", "betas"), "params": ("Ks", "w2c", "img_wh", "betas", "jaw_pose"),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "key"), [(kind, key) for kind, keys in ESSENTIAL.items() for key in keys])
def test_wrong_entries_are_named(copies: Callable[[str], Path], kind: str, key: str) -> None:
    folder = copies(kind)
    file = next(file for file in files(folder) if file.parent.name != "meta" and file.stem != "cameras")
    whole = file.read_bytes()
    for wrong in (None, "text", np.zeros((7, 1, 1)), float("nan"), {"a": 1}, [[1], [2, 3]]):

        def change(table: dict[Any, Any], wrong: Any = wrong) -> None:
            if wrong is None:
                del table[key]
            elif file.suffix == ".json" and isinstance(wrong, np.ndarray):
                table[key] = wrong.tolist()
            elif file.suffix == ".npz":
                table[key] = np.asarray(str(wrong)) if isinstance(wrong, (dict, list)) else np.asarray(wrong)
            elif file.suffix in (".pt", ".pth") and isinstance(wrong, np.ndarray):
                table[key] = torch.from_numpy(wrong)
            else:
                table[key] = wrong

        file.write_bytes(whole)
        file.write_bytes(_tampered(file, change))
        with pytest.raises(InputError):
            read(kind, folder)


def test_matrices_that_do_not_rotate(copies: Callable[[str], Path]) -> None:
    folder = copies("romp")
    arrays = dict(np.load(folder / "cameras.npz"))
    arrays["extrinsic"] = np.diag([1.0, 1.0, -1.0, 1.0])
    np.savez(folder / "cameras.npz", **arrays)
    with pytest.raises(InputError, match="extrinsic holds no rotations"):
        read("romp", folder)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_there(kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(kind, tmp_path / "missing")
    assert "body.source" in str(caught.value)


def test_frames_that_differ_are_named(copies: Callable[[str], Path]) -> None:
    folder = copies("smplerx")
    file = folder / "smplx/00002_0.npz"
    np.savez(file, **(dict(np.load(file)) | {"betas": np.zeros((1, 12))}))
    with pytest.raises(InputError, match="betas has another shape in other frames"):
        read("smplerx", folder)


def test_absurd_sizes(tmp_path: Path) -> None:
    """Headers that promise what the file does not have, before memory is taken for it; and bombs."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 1000)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("poses.npy", header.getvalue())
    with pytest.raises(InputError, match="promises"):
        read_arrays(tmp_path / "a.npz")
    wrapper = writers.joblib_dumps({"a": np.zeros(3)})
    assert wrapper.count(b"K\x03\x85") == 1
    for shape in (b"J\xff\xff\xff\x7f\x85", b"J\xff\xff\xff\xff\x85"):
        (tmp_path / "a.pkl").write_bytes(wrapper.replace(b"K\x03\x85", shape))
        with pytest.raises(InputError):
            read_joblib(tmp_path / "a.pkl")


@pytest.mark.parametrize(
    ("magic", "name"),
    [
        (b"\x1f\x8b\x08", "gzip"),
        (b"BZh9", "bz2"),
        (b"\xfd7zXZ\x00", "xz"),
        (b"]\x00\x00", "lzma"),
        (b"\x04\x22M\x18", "lz4"),
    ],
)
def test_other_compressions_are_named(tmp_path: Path, magic: bytes, name: str) -> None:
    (tmp_path / "a.pkl").write_bytes(magic + bytes(30))
    with pytest.raises(InputError, match=f"compressed by {name}"):
        read_joblib(tmp_path / "a.pkl")


def test_a_pickle_cannot_change_what_reads_it(tmp_path: Path) -> None:
    """BUILD on what a pickle names: it would set attributes of our functions and classes, or an array's memory."""
    from soar.models import pickles

    before = {key: dict(getattr(value, "__dict__", {})) for key, value in vars(pickles).items() if callable(value)}
    state = b"N}\x8c\x0b__defaults__)s\x86b."
    for name in (
        b"cnumpy.core.multiarray\n_reconstruct\n",
        b"cnumpy\ndtype\n",
        b"c_codecs\nencode\n",
        b"cnumpy\nndarray\n",
    ):
        (tmp_path / "a.pkl").write_bytes(b"\x80\x04" + name + state)
        with pytest.raises(InputError, match="cannot be read"):
            read_joblib(tmp_path / "a.pkl")
    after = {key: dict(getattr(value, "__dict__", {})) for key, value in vars(pickles).items() if callable(value)}
    assert before == after
