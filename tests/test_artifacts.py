from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest
import torch

from soar.artifacts import (
    ImageArchive,
    atomic_path,
    read_json,
    read_npz,
    read_tensors,
    write_images,
    write_json,
    write_npz,
    write_tensors,
)
from soar.errors import ArtifactError, StorageError


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "a.json"
    write_json(target, {"a": 1})
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert read_json(target) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="free disk space"), atomic_path(tmp_path / "a"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_really_full_device_is_named(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with pytest.raises(StorageError), atomic_path(tmp_path / "a"), open("/dev/full", "wb", buffering=0) as stream:
        stream.write(b"x")


@pytest.mark.parametrize("reader", [read_json, read_npz, read_tensors, ImageArchive])
def test_missing_and_truncated_files_are_named(tmp_path: Path, reader) -> None:
    with pytest.raises(ArtifactError, match="missing"):
        reader(tmp_path / "absent")
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK\x03\x04 truncated")
    with pytest.raises(ArtifactError, match=r"broken\.npz"):
        reader(broken)


def test_arrays_and_tensors_round_trip(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6).reshape(2, 3), "b": np.float32(2.5)}
    write_npz(tmp_path / "a.npz", arrays)
    back = read_npz(tmp_path / "a.npz")
    assert all(np.array_equal(back[k], arrays[k]) for k in arrays)
    write_tensors(tmp_path / "t.safetensors", {"x": torch.arange(4.0)[::2]}, {"unit": "metres"})
    tensors, metadata = read_tensors(tmp_path / "t.safetensors")
    assert tensors["x"].tolist() == [0.0, 2.0]
    assert metadata == {"unit": "metres"}


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "o.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ArtifactError):
        read_npz(tmp_path / "o.npz")


@pytest.mark.parametrize("shape", [(7, 5, 3), (7, 5)])
def test_images_round_trip_in_order_and_bytes_depend_on_images_only(tmp_path: Path, shape: tuple[int, ...]) -> None:
    images = [np.full(shape, i, np.uint8) for i in range(12)]
    images[3][..., 0] = 200
    assert write_images(tmp_path / "a.zip", iter(images), ".png") == 12
    write_images(tmp_path / "b.zip", images, ".png")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    archive = ImageArchive(tmp_path / "a.zip")
    assert len(archive) == 12
    assert all(np.array_equal(a, b) for a, b in zip(archive, images, strict=True))
