"""A user's synchronised multi-camera captures: one folder each, with a calibration file and a recording per camera."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from soar.datasets.recordings import VIDEO_SUFFIXES, recording
from soar.datasets.selection import FrameSettings, SubjectSettings, check_split
from soar.datasets.video import sequence_names
from soar.errors import CalibrationError, InputError

if TYPE_CHECKING:
    from soar.datasets.capture import Capture


@dataclasses.dataclass(frozen=True)
class CamerasSettings:
    """Configuration of captures of one's own.

    Attributes:
        name: name of the dataset, the folder below ``results/``.
        adapter: ``cameras``.
        path: a capture folder, or several.
        calibration: name of the calibration file in each capture folder.
        train, eval: camera names; ``eval`` None is every other camera.
        size_mismatch: see :func:`soar.datasets.calibration.match_size`.
        frames, subject: see there.
    """

    name: str
    adapter: str
    path: str | tuple[str, ...] | None
    calibration: str
    train: tuple[str, ...]
    eval: tuple[str, ...] | None
    size_mismatch: Literal["error", "crop", "resize"]
    frames: FrameSettings
    subject: SubjectSettings


class Cameras:
    """Captures in the layout of ``docs/data.md``: ``<capture>/calibration.json`` and ``<capture>/<camera>.mp4`` or
    ``<capture>/<camera>/`` with images, unless the calibration names another ``source``.
    """

    packaged = None
    provides: frozenset[str] = frozenset()

    def __init__(self, settings: CamerasSettings) -> None:
        self.settings = settings
        self._folders = sequence_names(settings.path)

    def sequences(self) -> list[str]:
        return list(self._folders)

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        known = list(self._entries(sequence))
        train = self.settings.train
        evaluation = self.settings.eval
        if evaluation is None:
            evaluation = tuple(name for name in known if name not in train)
        check_split(train, evaluation, known, str(self._file(sequence)))
        return list({"all": train + evaluation, "train": train, "eval": evaluation}[which])

    def sources(self, sequence: str) -> list[Path]:
        recordings = [recording(self._path(sequence, name)) for name in self.cameras(sequence)]
        return [self._file(sequence), *(file for entry in recordings for file in entry.files())]

    def downloads(self) -> list[Path]:
        return []

    def capture(self, sequence: str) -> Capture:
        paths = {name: self._path(sequence, name) for name in self.cameras(sequence)}
        train, evaluation = (tuple(self.cameras(sequence, which)) for which in ("train", "eval"))
        return calibrated_capture(
            sequence,
            read_json_strictly(self._file(sequence)),
            self._file(sequence).name,
            paths,
            (train, evaluation),
            self.settings.size_mismatch,
            self.settings.frames,
            self.settings.subject,
        )

    def _file(self, sequence: str) -> Path:
        return self._folders[sequence] / self.settings.calibration

    def _entries(self, sequence: str) -> Mapping[str, Any]:
        value = read_json_strictly(self._file(sequence))
        cameras = value.get("cameras") if isinstance(value, Mapping) else None
        if not isinstance(cameras, Mapping) or not all(isinstance(entry, Mapping) for entry in cameras.values()):
            raise CalibrationError(
                f"{self._file(sequence)}: cameras", expected="a mapping from camera name to its parameters"
            )
        return cameras

    def _path(self, sequence: str, camera: str) -> Path:
        folder, source = self._folders[sequence], self._entries(sequence)[camera].get("source")
        if source is not None:
            return folder / str(source)
        found = [folder / camera] if (folder / camera).is_dir() else []
        found += sorted(p for p in folder.glob(f"{camera}.*") if p.suffix.lower() in VIDEO_SUFFIXES)
        if len(found) != 1:
            raise InputError(
                f"camera {camera}: {'no recording' if not found else 'several recordings'} in {folder}",
                expected=f"one video {camera}.mp4 (.mov, .mkv, ...) or one folder of images {camera}/",
                got=", ".join(path.name for path in found) or "nothing",
                cure=f'add it, or name it as "source" of {camera} in {self.settings.calibration}',
            )
        return found[0]


def calibrated_capture(
    name: str,
    calibration: Any,
    where: str,
    paths: Mapping[str, Path],
    split: tuple[tuple[str, ...], tuple[str, ...]],
    size_mismatch: Literal["error", "crop", "resize"],
    frames: FrameSettings,
    subject: SubjectSettings,
) -> Capture:
    """Open the recordings of a calibrated capture and fit the calibration to them.

    Args:
        name: the sequence's name.
        calibration: the content of a calibration file (schema in ``docs/data.md``).
        where: its name, for messages.
        paths: the recording of each camera used, training cameras first.
        split: names of the training and of the evaluation cameras.
        size_mismatch: see :func:`soar.datasets.calibration.match_size`.
        frames, subject: the settings.

    Raises:
        CalibrationError: a malformed calibration, or one that does not match the frames.
        InputError: a recording that is missing or cannot be read.
    """
    from soar.datasets.calibration import match_size, parse_calibration
    from soar.datasets.capture import Capture

    parsed = parse_calibration(calibration, where)
    if missing := [camera for camera in paths if camera not in parsed.cameras]:
        raise CalibrationError(f"{where} lacks cameras", expected=", ".join(paths), got=f"no {', '.join(missing)}")
    recordings = {camera: recording(path) for camera, path in paths.items()}
    matched = [match_size(parsed.cameras[camera], entry.probe, size_mismatch) for camera, entry in recordings.items()]
    return Capture(
        name=name,
        cameras=tuple(camera for camera, _ in matched),
        recordings=recordings,
        train=split[0],
        eval=split[1],
        up=parsed.up,
        fps=parsed.fps,
        frames=frames,
        subject=subject,
        remarks=parsed.remarks + tuple(remark for _, remark in matched if remark),
    )


def read_json_strictly(path: Path) -> Any:
    """Read a user's JSON; a key that stands twice in one mapping is an error, not the last one's win.

    Raises:
        CalibrationError: the file is missing, not JSON, or names a key twice.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if repeated := sorted({key for key in keys if keys.count(key) > 1}):
            raise ValueError(f"{', '.join(repeated)} stands twice")
        return dict(pairs)

    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=unique)
    except OSError as error:
        raise CalibrationError(
            f"{path} cannot be read: {error.strerror}", expected="a calibration file", cure="see docs/data.md"
        ) from error
    except ValueError as error:
        raise CalibrationError(f"{path} is not usable JSON: {error}", cure="see docs/data.md") from error
