"""The default capture: four calibrated, synchronised cameras around one person, from a published package."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from soar.datasets.cameras import calibrated_capture
from soar.datasets.packaged import PackagedFiles
from soar.datasets.selection import FrameSettings, SubjectSettings, check_split
from soar.errors import InputError

if TYPE_CHECKING:
    from soar.datasets.capture import Capture


@dataclasses.dataclass(frozen=True)
class DemoSettings:
    """Configuration of the default capture.

    Attributes:
        name: name of the dataset, the folder below ``results/``.
        adapter: ``demo``.
        sequence: name of its one sequence.
        packaged: the package and the files taken from it.
        calibration: the Qualisys calibration among those files.
        videos: camera name -> video among those files.
        train, eval: camera names.
        frames, subject: see there.
    """

    name: str
    adapter: str
    sequence: str
    packaged: PackagedFiles
    calibration: str
    videos: dict[str, str]
    train: tuple[str, ...]
    eval: tuple[str, ...]
    frames: FrameSettings
    subject: SubjectSettings


class Demo:
    """One sequence; its calibration is translated into the form of ``docs/data.md``."""

    provides: frozenset[str] = frozenset()

    def __init__(self, settings: DemoSettings) -> None:
        self.settings = settings
        self.packaged = settings.packaged

    def sequences(self) -> list[str]:
        return [self.settings.sequence]

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        train, evaluation = self.settings.train, self.settings.eval
        check_split(train, evaluation, self.settings.videos, "dataset.videos")
        return list({"all": train + evaluation, "train": train, "eval": evaluation}[which])

    def sources(self, sequence: str) -> list[Path]:
        return [self._path(self.settings.calibration), *map(self._path, self.settings.videos.values())]

    def downloads(self) -> list[Path]:
        return self.packaged.paths()

    def capture(self, sequence: str) -> Capture:
        from soar.datasets.qualisys import read_qualisys

        if damaged := self.packaged.damaged():
            raise InputError(
                f"{', '.join(map(str, damaged))}: missing or of another content than published",
                cure="run `python -m soar fetch`",
            )
        settings, file = self.settings, self._path(self.settings.calibration)
        return calibrated_capture(
            sequence,
            read_qualisys(file),
            file.name,
            {camera: self._path(settings.videos[camera]) for camera in self.cameras(sequence)},
            (settings.train, settings.eval),
            "crop",  # two of the videos lack the last 8 columns of the calibrated image
            settings.frames,
            settings.subject,
        )

    def _path(self, name: str) -> Path:
        return Path(self.settings.packaged.folder) / name
