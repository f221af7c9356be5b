"""Masks that the user made elsewhere: a folder of images or a video, brought to the stored frames."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from soar.datasets import adapter
from soar.datasets.ingest import Undistortion
from soar.datasets.recordings import ImageFolder, Recording, recording
from soar.datasets.sequence import Sequence
from soar.errors import ConfigError, InputError
from soar.perception.diagnostics import TRUSTED
from soar.perception.region import resized

_NEUTRAL = 32  # of 255: by how much compression may colour a grey picture


@dataclasses.dataclass(frozen=True)
class MaskFileSettings:
    """Where masks are and what they mean; see ``conf/masks/files.yaml``."""

    provider: Literal["files"]
    source: str | None
    dataset: dict[str, Any]
    made_of: Literal["recording", "frames"]
    match: Literal["number", "order"]
    first_number: int
    plane: Literal["brightness", "alpha"]
    white: float | None
    min_agreement: float


class MaskFiles:
    """The masks of one camera.

    Args:
        settings: see the conf file.
        source: the folder of images, or the video.
        sequence: the frames they belong to.
        camera: name of the camera.

    Raises:
        ConfigError: a way to match that the source does not allow.
        InputError: nothing is there, numbers are missing, or the count is another.
    """

    def __init__(self, settings: MaskFileSettings, source: Path, sequence: Sequence, camera: str) -> None:
        self._settings, self._source = settings, recording(source)
        self._camera = stored = sequence.camera(camera)
        recorded: Recording | None = None
        if settings.made_of == "recording":
            capture = adapter(settings.dataset).capture(sequence.name)
            recorded = capture.recordings[camera]
            self._camera = next(entry for entry in capture.cameras if entry.name == camera)
        self._width, self._height = stored.width, stored.height
        self._lens = (stored.width, stored.height), Undistortion(self._camera.resized(stored.width, stored.height))
        by_number = settings.match == "number"
        self._positions = (self._numbered if by_number else self._ordered)(sequence.frame_ids, recorded)

    def masks(self, body: np.ndarray) -> Iterator[np.ndarray]:
        """Alpha (H, W) float32 in [0, 1] of every stored frame in order, one in memory at a time.

        Args:
            body: (T, 25, 3) keypoints of the subject, confidence 0 where unknown.

        Raises:
            InputError: a mask that cannot be read, is white all over, coloured, or of another shape than the frames; at
                the end: masks that are all empty, or do not lie on the keypoints.
        """
        held: list[float] = []
        empty = True
        for (name, picture), points in zip(self._pictures(), body, strict=True):
            plane = self._plane(picture, name)
            if plane.min() > 0.5:
                raise InputError(
                    f"{name} is white all over",
                    expected="white where the person is, black elsewhere",
                    cure="export the mask again; masks.plane says whether it is the alpha channel or the colours",
                )
            alpha = self._placed(plane, name)
            empty = empty and alpha.max() <= 0.5
            if (share := _share_held(alpha, points)) is not None:
                held.append(share)
            yield alpha
        if empty:
            raise InputError(
                f"{self._source.path} holds empty masks only",
                expected="white where the person is",
                cure="set masks.white=1 if they hold 0 and 1, masks.plane if the mask is in the alpha channel",
            )
        if held and (agreement := float(np.median(held))) < self._settings.min_agreement:
            raise InputError(
                f"{self._source.path}: the masks are not on the person whose keypoints were found",
                expected=f"{self._settings.min_agreement:.0%} of the keypoints on the mask (masks.min_agreement)",
                got=f"{agreement:.0%} in the median frame",
                cure="check that white is the person, that it is this camera and this person, and masks.first_number",
            )

    # which mask belongs to which frame

    def _numbered(self, ids: tuple[int, ...], recorded: Recording | None) -> list[int]:
        """Positions in the source by the numbers in file names."""
        if not isinstance(self._source, ImageFolder):
            raise ConfigError(
                "masks.match=number, but the frames of a video have no numbers",
                expected="order",
                got=str(self._source.path),
            )
        first, own = self._settings.first_number, recorded.probe.numbers if recorded else None
        if recorded is None:
            wanted = [first + t for t in range(len(ids))]
        else:
            wanted = [first + t if own is None else own[t] for t in ids]
        with _decoding(self._source.path):
            numbers = self._source.probe.numbers or ()
        there = {number: position for position, number in enumerate(numbers)}
        if missing := [number for number in wanted if number not in there]:
            raise InputError(
                f"{self._source.path} lacks masks of {len(missing)} of {len(wanted)} frames",
                expected=f"images numbered {wanted[0]} to {wanted[-1]}, such as {wanted[0]:06d}.png",
                got=f"{min(there)} to {max(there)}, without {', '.join(map(str, missing[:5]))}",
                cure="add them (black where nobody is), or set masks.first_number, masks.made_of or masks.match=order",
            )
        return [there[number] for number in wanted]

    def _ordered(self, ids: tuple[int, ...], recorded: Recording | None) -> list[int]:
        """Positions in the source where it has a mask for every frame kept, or for every one recorded."""
        count = self._source.count
        if count == len(ids):
            return list(range(count))
        if recorded is not None and count == recorded.count:
            return list(ids)
        raise InputError(
            f"{self._source.path} holds {count} masks",
            expected=f"{len(ids)}, one for every frame kept"
            + (f", or {recorded.count}, one for every frame recorded" if recorded else ""),
            got=str(count),
            cure="export one mask for every frame; or number the images and set masks.match=number",
        )

    # what a picture says

    def _pictures(self) -> Iterator[tuple[str, np.ndarray]]:
        """Name and picture as stored, RGB or RGBA, of every frame."""
        path = self._source.path
        if not isinstance(self._source, ImageFolder):
            # Frames are kept in increasing order, so positions are too.
            for position, picture in zip(self._positions, self._source.frames(self._positions), strict=True):
                yield f"{path}, frame {position}", picture
            return
        files = self._source.files()
        for position in self._positions:
            yield str(files[position]), read_picture(files[position])

    def _plane(self, picture: np.ndarray, name: str) -> np.ndarray:
        """(h, w) float32 in [0, 1] of a picture (h, w) or (h, w, C), 8 or 16 bit or float."""
        whole = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1.0
        if self._settings.plane == "alpha":
            if picture.ndim == 2 or picture.shape[2] != 4:
                raise InputError(
                    f"{name} has no alpha channel",
                    expected="RGBA",
                    got=str(picture.shape),
                    cure="masks.plane=brightness",
                )
            plane = picture[..., 3].astype(np.float32)
        else:
            colours = np.atleast_3d(picture)[..., :3].astype(np.float32)
            if np.ptp(colours, axis=2).max() > whole * _NEUTRAL / 255:
                raise InputError(
                    f"{name} is coloured",
                    expected="white where the person is, black elsewhere",
                    got=f"a picture {picture.shape} with colours",
                    cure="masks.plane=alpha takes the alpha channel of cut-outs; export other pictures in grey",
                )
            plane = colours.mean(2)
        white = self._settings.white or whole
        if plane.max() > 1.01 * white:
            raise InputError(
                f"{name} is brighter than white",
                expected=f"at most {white:g} (masks.white)",
                got=f"{plane.max():g}",
                cure="set masks.white to the value of white in the files, or null for the largest that they can hold",
            )
        return np.minimum(plane / white, 1)

    def _placed(self, plane: np.ndarray, name: str) -> np.ndarray:
        """The plane on the stored frame: without the lens's distortion, at the frame's size."""
        height, width = plane.shape
        camera = self._camera
        if abs(width * camera.height - height * camera.width) > (camera.width + camera.height) / 2:
            raise InputError(
                f"{name} has another shape than the {self._settings.made_of}",
                expected=f"{camera.width}x{camera.height}, or smaller or larger by one factor",
                got=f"{width}x{height}",
                cure="export whole masks, upright, without border or crop; masks.made_of says of what they were made",
            )
        if (width, height) != self._lens[0]:
            self._lens = (width, height), Undistortion(camera.resized(width, height))
        return resized(self._lens[1](plane), self._height, self._width)


def read_picture(file: Path) -> np.ndarray:
    """(h, w) or (h, w, C) as stored, of its own depth; colours in any order."""
    with _decoding(file):
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise InputError(f"{file} cannot be decoded as an image", cure="check that the file is complete")
    return picture


@contextlib.contextmanager
def _decoding(path: Path) -> Iterator[None]:
    """OpenCV refuses pictures of absurd size by an exception of its own."""
    try:
        yield
    except cv2.error as error:
        raise InputError(f"{path} cannot be decoded", got=str(error).strip(), cure="export the masks again") from error


def _share_held(alpha: np.ndarray, points: np.ndarray) -> float | None:
    """Share of trusted keypoints (25, 3) within the picture that the mask holds; None where there is no such point."""
    height, width = alpha.shape
    columns, rows = np.floor(points[:, :2].T).astype(int)
    counted = (points[:, 2] >= TRUSTED) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    return float((alpha[rows[counted], columns[counted]] > 0.5).mean()) if counted.any() else None
