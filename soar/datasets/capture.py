"""What an adapter hands over: recordings, their cameras and what else is known, before any frame is chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from soar.datasets.packaged import PackagedFiles
from soar.datasets.recordings import Recording
from soar.datasets.selection import FrameSettings, SubjectSettings
from soar.datasets.truth import Truth
from soar.geometry.cameras import Camera


@dataclasses.dataclass(frozen=True)
class Capture:
    """One recording session.

    Attributes:
        name: the sequence's name.
        cameras: as calibrated for the recorded frames, training first; distortion not yet removed.
        recordings: the frames of each camera by name.
        train, eval: names of the training and evaluation cameras.
        up: (3,) direction against gravity in world axes.
        fps: rate the calibration states, frames per second; None leaves it to the recordings.
        frames, subject: the settings.
        remarks: sentences the user should read.
        truth: what the dataset knows besides its footage; None where it knows nothing.
    """

    name: str
    cameras: tuple[Camera, ...]
    recordings: Mapping[str, Recording]
    train: tuple[str, ...]
    eval: tuple[str, ...]
    up: np.ndarray
    fps: float | None
    frames: FrameSettings
    subject: SubjectSettings
    remarks: tuple[str, ...]
    truth: Truth | None = None


class Adapter(Protocol):
    """One kind of dataset. Everything but :meth:`capture` is cheap: it is called whenever the workflow is parsed.

    Attributes:
        packaged: files that ``python -m soar fetch`` brings; None for the user's own data.
        provides: what the dataset gives besides footage, named as the stages that otherwise estimate it: of ``masks``,
            ``keypoints``, ``body`` and ``normals``. Their provider ``dataset`` takes it from there.
    """

    packaged: PackagedFiles | None
    provides: frozenset[str]

    def sequences(self) -> list[str]:
        """Names of the sequences."""

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        """Camera names of a sequence, training first: ``all``, ``train`` or ``eval``."""

    def sources(self, sequence: str) -> list[Path]:
        """The input files of a sequence."""

    def downloads(self) -> list[Path]:
        """The files the ``fetch`` stage brings; none for the user's own data."""

    def capture(self, sequence: str) -> Capture:
        """Open a sequence's recordings and calibration; reads calibration and first frames, decodes no clip."""
