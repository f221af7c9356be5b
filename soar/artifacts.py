"""Reading and writing the files that stages exchange. Nothing half-written is ever left under a final name.

Every writer goes through :func:`atomic_path`; every reader raises :class:`~soar.errors.ArtifactError` for a file
that is missing, truncated or of another layout, naming the stage output to delete so that it is made again.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.errors import ArtifactError, StorageError


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; on success it is flushed to disk and renamed to ``path``.

    On any exception the temporary file is removed and ``path`` is left as it was.

    Raises:
        StorageError: the disk is full, or the folder is not writable.
    """
    target = Path(path)
    temporary: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=target.suffix)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with open(temporary, "rb+") as stream:
            os.fsync(stream.fileno())
        temporary.chmod(0o644)
        os.replace(temporary, target)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EPERM):
            raise StorageError(
                f"cannot write {target}: {error.strerror}",
                cure="free disk space or choose a writable folder, run again",
            ) from error
        raise
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def remove_leftovers(path: str | os.PathLike[str]) -> None:
    """Remove what killed writers of ``path`` left; nobody may be writing it now."""
    target = Path(path)
    for leftover in target.parent.glob(f".{glob.escape(target.stem)}.????????{target.suffix}"):
        leftover.unlink(missing_ok=True)


@contextlib.contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[None]:
    try:
        yield
    except ArtifactError:
        raise
    except FileNotFoundError as error:
        raise ArtifactError(f"{path} is missing", cure="run snakemake; it makes what is missing") from error
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ArtifactError(
            f"{path} cannot be read: {error}", cure="delete the file and run snakemake; it is made again"
        ) from error


def sha256_file(path: str | os.PathLike[str]) -> str:
    """Hex sha256 of a file's content, read in blocks."""
    with _reading(path), open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


_NOTES = ("evidence.jpg", "health.json", "provenance.json")  # what stages leave about themselves


def members(path: Path) -> list[Path]:
    """The files an input is made of: itself, or what lies in a folder and below, less notes and hidden files."""
    if not path.is_dir():
        return [path]
    files = (file for file in path.rglob("*") if file.is_file() and not file.name.endswith(_NOTES))
    return sorted(file for file in files if not any(part.startswith(".") for part in file.relative_to(path).parts))


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not JSON")


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write JSON with sorted keys; numpy scalars and arrays become numbers and lists."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, default=_plain) + "\n")


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a JSON file."""
    with _reading(path):
        return json.loads(Path(path).read_text(encoding="utf-8"))


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], compress: bool = False) -> None:
    """Write named arrays (no object arrays) to one ``.npz``."""
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        (np.savez_compressed if compress else np.savez)(stream, allow_pickle=False, **arrays)


def read_npz(path: str | os.PathLike[str], keys: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Read all arrays, or just ``keys``, of an ``.npz`` without unpickling anything."""
    with _reading(path), np.load(path, allow_pickle=False) as data:
        return {k: data[k] for k in (data.files if keys is None else keys)}


def write_tensors(path: str | os.PathLike[str], tensors: Mapping[str, Any], metadata: Mapping[str, str]) -> None:
    """Write torch tensors and string metadata to one ``.safetensors`` file."""
    from safetensors.torch import save

    # Written here and not by the library, whose own error for a full disk would not be told from any other.
    content = save({k: v.detach().contiguous().cpu() for k, v in tensors.items()}, dict(metadata))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def read_tensors(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Read a ``.safetensors`` file: tensors by name, and its string metadata."""
    from safetensors import SafetensorError, safe_open

    with _reading(path):
        try:
            with safe_open(path, framework="pt") as data:
                return {k: data.get_tensor(k) for k in data.keys()}, dict(data.metadata() or {})  # noqa: SIM118
        except SafetensorError as error:
            raise ValueError(error) from error


class ImageArchive:
    """Frames of one camera in one uncompressed zip of encoded images (``000000.jpg`` or ``.png``), in frame order.

    Indexing decodes one image at a time, so memory does not grow with the clip.

    Args:
        path: the archive.
        plane: which of the planes that :func:`write_planes` wrote.
    """

    def __init__(self, path: str | os.PathLike[str], plane: str = "") -> None:
        self.path = Path(path)
        with _reading(path):
            self._zip = zipfile.ZipFile(path)
            self.names = sorted(name for name in self._zip.namelist() if name.rpartition("/")[0] == plane)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> np.ndarray:
        """Decode frame ``index``: (H, W, 3) RGB uint8, or (H, W) uint8 or uint16 for single-channel images."""
        import cv2

        with _reading(self.path):
            data = np.frombuffer(self._zip.read(self.names[index]), np.uint8)
            image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
            if image is None:
                raise ValueError(f"{self.names[index]} is not an image")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[i] for i in range(len(self)))


def write_images(path: str | os.PathLike[str], images: Iterable[np.ndarray], suffix: str, quality: int = 95) -> int:
    """Write images to an :class:`ImageArchive`, one at a time.

    Args:
        path: the archive to write.
        images: (H, W, 3) RGB or (H, W) uint8 arrays.
        suffix: ``.jpg`` (at ``quality``) or ``.png``.
        quality: JPEG quality, 1 to 100.

    Returns:
        the number of images written.
    """
    return _write_archive(path, ({f"{{:06d}}{suffix}": encode_image(image, suffix, quality)} for image in images))


def write_planes(path: str | os.PathLike[str], frames: Iterable[Mapping[str, np.ndarray]]) -> int:
    """Write several planes of every frame to one archive of PNG images, to be read as ``ImageArchive(path, plane)``.

    Args:
        path: the archive to write.
        frames: plane name -> (H, W, 3) RGB or (H, W) uint8, or (H, W) uint16; one frame is in memory at a time.

    Returns:
        the number of frames written.
    """
    encoded = (
        {f"{name}/{{:06d}}.png": encode_image(image, ".png") for name, image in frame.items()} for frame in frames
    )
    return _write_archive(path, encoded)


def _write_archive(path: str | os.PathLike[str], frames: Iterable[Mapping[str, bytes]]) -> int:
    """Write the files of every frame, whose names are formats of the frame's number; returns the number of frames."""
    count = 0
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for count, files in enumerate(frames, start=1):
            for name, content in files.items():
                # A fixed date makes the bytes a function of the images alone.
                archive.writestr(zipfile.ZipInfo(name.format(count - 1)), content)
    return count


def encode_image(image: np.ndarray, suffix: str, quality: int = 90) -> bytes:
    """Encode an RGB or grey uint8 image as ``.jpg``, ``.png`` or ``.webp`` bytes; ``.png`` takes grey uint16 too."""
    import cv2

    flags = {".jpg": [cv2.IMWRITE_JPEG_QUALITY, quality], ".webp": [cv2.IMWRITE_WEBP_QUALITY, quality]}
    image = np.ascontiguousarray(image)
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    done, data = cv2.imencode(suffix, bgr, flags.get(suffix, []))
    if not done:
        raise ArtifactError(f"an image of shape {image.shape} cannot be encoded as {suffix}")
    return data.tobytes()


def write_image(path: str | os.PathLike[str], image: np.ndarray, quality: int = 90) -> None:
    """Write one RGB or grey uint8 image; the format follows the suffix."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_image(image, Path(path).suffix, quality))
