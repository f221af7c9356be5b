"""Recordings: a video file or a folder of numbered images, read one frame at a time.

OpenCV is imported where a frame is decoded, so that naming and listing recordings stays cheap.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import math
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from soar.errors import InputError

if TYPE_CHECKING:
    import cv2
    import numpy as np

VIDEO_SUFFIXES = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".webm", ".wmv")
IMAGE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")


@dataclasses.dataclass(frozen=True)
class Probe:
    """What a recording says of itself.

    Attributes:
        width, height: frame size in pixels, upright.
        promised: frames the container claims; None where it claims none.
        fps: frames per second; None where the recording does not say.
        numbers: numbers in the file names of an image folder; None for a video.
    """

    width: int
    height: int
    promised: int | None
    fps: float | None
    numbers: tuple[int, ...] | None


class Recording(Protocol):
    """The frames of one camera."""

    path: Path

    def files(self) -> list[Path]:
        """The files it is made of."""

    @property
    def probe(self) -> Probe:
        """Size and rate; decodes the first frame only."""

    @property
    def count(self) -> int:
        """Frames that can be decoded; found by decoding them, on first use."""

    def frames(self, ids: Collection[int]) -> Iterator[np.ndarray]:
        """(H, W, 3) RGB uint8 of the frames ``ids`` (increasing), in order, one in memory at a time."""

    def digest(self) -> str:
        """Hex sha256 of the content."""


def recording(path: Path) -> Recording:
    """The recording at ``path``: a folder is a folder of images, a file is a video.

    Raises:
        InputError: there is nothing at ``path``.
    """
    if path.is_dir():
        return ImageFolder(path)
    if path.is_file():
        return VideoFile(path)
    raise InputError(f"{path} does not exist", expected="a video file or a folder of images", cure="correct the path")


class VideoFile:
    """A video in any container OpenCV reads; rotation metadata is honoured."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def files(self) -> list[Path]:
        return [self.path]

    def digest(self) -> str:
        return _digest(self.files())

    @contextlib.contextmanager
    def _open(self) -> Iterator[cv2.VideoCapture]:
        import cv2

        if not self.path.is_file():
            raise InputError(f"{self.path} does not exist", expected="a video file", cure="correct the path")
        capture = cv2.VideoCapture(str(self.path))
        try:
            if not capture.isOpened():
                raise InputError(
                    f"{self.path} cannot be opened as a video",
                    expected="a container and codec OpenCV reads, such as H.264 in .mp4",
                    got=f"{self.path.stat().st_size} bytes",
                    cure="play it to check that it is complete, or convert it with a video tool",
                )
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
            yield capture
        finally:
            capture.release()

    @functools.cached_property
    def probe(self) -> Probe:
        import cv2

        with self._open() as capture:
            decoded, image = capture.read()
            promised, fps = capture.get(cv2.CAP_PROP_FRAME_COUNT), capture.get(cv2.CAP_PROP_FPS)
        if not decoded:
            raise InputError(
                f"{self.path} holds no frame that can be decoded", cure="play it to check; record or convert it again"
            )
        return Probe(
            width=image.shape[1],
            height=image.shape[0],
            promised=int(promised) if math.isfinite(promised) and 0 < promised < 1e9 else None,
            fps=fps if math.isfinite(fps) and 0 < fps < 1e4 else None,
            numbers=None,
        )

    @functools.cached_property
    def count(self) -> int:
        # Containers round, estimate or omit their frame count: only decoding tells.
        with self._open() as capture:
            return sum(1 for _ in iter(capture.grab, False))

    def frames(self, ids: Collection[int]) -> Iterator[np.ndarray]:
        import cv2

        wanted, last = frozenset(ids), max(ids)
        with self._open() as capture:
            for position in range(last + 1):
                if not capture.grab():
                    raise InputError(
                        f"{self.path} ends before frame {position}",
                        expected=f"{last + 1} frames",
                        cure="copy the file again; if it was replaced since the frames were chosen, run snakemake",
                    )
                if position in wanted:
                    decoded, image = capture.retrieve()
                    if not decoded:
                        raise InputError(
                            f"{self.path}: frame {position} cannot be decoded", cure="convert the video again"
                        )
                    yield cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


class ImageFolder:
    """A folder of images, ordered by the last number in each file name."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @functools.cached_property
    def _numbered(self) -> tuple[tuple[int, Path], ...]:
        images = [p for p in self.path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
        if not images:
            raise InputError(
                f"{self.path} holds no images",
                expected=f"files ending in {', '.join(IMAGE_SUFFIXES)}",
                cure="put the frames there, or name the folder that holds them",
            )
        found: dict[int, Path] = {}
        for image in images:
            digits = re.findall(r"\d+", image.stem)
            if not digits:
                raise InputError(
                    f"{image} has no frame number in its name",
                    expected="a name such as frame_000012.jpg",
                    cure="rename it, or move it elsewhere if it is no frame",
                )
            other = found.setdefault(int(digits[-1]), image)
            if other != image:
                raise InputError(
                    f"{self.path}: {other.name} and {image.name} carry the same frame number {int(digits[-1])}",
                    cure="keep one of the two",
                )
        return tuple(sorted(found.items()))

    def files(self) -> list[Path]:
        return [image for _, image in self._numbered]

    def digest(self) -> str:
        return _digest(self.files())

    @functools.cached_property
    def probe(self) -> Probe:
        numbered = self._numbered
        height, width = _read_image(numbered[0][1]).shape[:2]
        return Probe(width, height, len(numbered), None, tuple(number for number, _ in numbered))

    @property
    def count(self) -> int:
        return len(self._numbered)

    def frames(self, ids: Collection[int]) -> Iterator[np.ndarray]:
        probe, files = self.probe, self.files()
        for position in ids:
            image = _read_image(files[position])
            if image.shape[:2] != (probe.height, probe.width):
                raise InputError(
                    f"{self.path} mixes image sizes",
                    expected=f"{probe.width}x{probe.height} as in {files[0].name}",
                    got=f"{image.shape[1]}x{image.shape[0]} in {files[position].name}",
                    cure="export the frames again at one size",
                )
            yield image


def _read_image(path: Path) -> np.ndarray:
    import cv2

    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error as error:  # a header that claims more pixels than anyone has
        raise InputError(
            f"{path} cannot be decoded as an image", got=str(error).strip(), cure="export it again"
        ) from error
    if image is None:
        raise InputError(f"{path} cannot be decoded as an image", cure="check that the file is complete")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _digest(files: list[Path]) -> str:
    from soar.artifacts import sha256_file

    digests = [sha256_file(file) for file in files]
    if len(digests) == 1:
        return digests[0]
    listing = "".join(f"{file.name} {digest}\n" for file, digest in zip(files, digests, strict=True))
    return hashlib.sha256(listing.encode()).hexdigest()
