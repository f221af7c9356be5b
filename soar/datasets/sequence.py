"""The record of one sequence: its cameras, frames, split and origin. Every later stage starts from it."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from soar.artifacts import read_json, write_json
from soar.datasets.selection import check_split
from soar.errors import ArtifactError, CalibrationError
from soar.geometry.cameras import Camera


@dataclasses.dataclass(frozen=True)
class Source:
    """One input file (or folder of images) of a camera, with the digest of its content."""

    camera: str
    file: str
    sha256: str


@dataclasses.dataclass(frozen=True)
class Subject:
    """Whom to follow.

    Attributes:
        point: (x, y) on the person in pixels of the stored frames, or None.
        box: (x0, y0, x1, y1) around the person, likewise.
        frame: position in ``Sequence.frame_ids`` of the frame they are given in.
        stature_m: body height in metres, or None.
        camera: the camera they are given in; the first training camera.
    """

    point: tuple[float, float] | None
    box: tuple[float, float, float, float] | None
    frame: int
    stature_m: float | None
    camera: str


@dataclasses.dataclass(frozen=True)
class Sequence:
    """One synchronised recording of one person.

    Attributes:
        name: identifier, letters, digits, ``_`` and ``-``.
        fps: rate of the kept frames, per second.
        frame_ids: number of each kept frame in its recording, increasing.
        up: (3,) unit vector against gravity in world axes.
        train, eval: names of the training and of the evaluation cameras, disjoint.
        cameras: the cameras of both, training first; undistorted, sized as the stored frames.
        sources: the files the frames come from.
        subject: whom to follow.
        remarks: sentences the user should read (assumed intrinsics, cropped frames).

    Raises:
        ConfigError: a split that names an unknown camera, one camera twice, or no training camera.
        CalibrationError: an ``up`` that is no direction.
        ArtifactError: frame numbers or a rate that make no sequence.
    """

    name: str
    fps: float
    frame_ids: tuple[int, ...]
    up: np.ndarray
    train: tuple[str, ...]
    eval: tuple[str, ...]
    cameras: tuple[Camera, ...]
    sources: tuple[Source, ...]
    subject: Subject
    remarks: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "up", unit_up(self.up, f"sequence {self.name}"))
        check_split(self.train, self.eval, [camera.name for camera in self.cameras], f"sequence {self.name}")
        ids = np.asarray(self.frame_ids)
        if not re.fullmatch(r"[\w-]+", self.name):
            raise ArtifactError(
                "a sequence has an unusable name", expected="letters, digits, _ and -", got=repr(self.name)
            )
        if ids.size == 0 or (np.diff(ids) <= 0).any() or ids[0] < 0:
            raise ArtifactError(
                f"sequence {self.name}: frame_ids must increase from 0 or more", got=str(self.frame_ids)[:80]
            )
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ArtifactError(f"sequence {self.name}: fps must be positive", got=repr(self.fps))
        if not 0 <= self.subject.frame < ids.size:
            raise ArtifactError(f"sequence {self.name}: subject.frame is outside the clip", got=str(self.subject.frame))

    def __len__(self) -> int:
        return len(self.frame_ids)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names, training first."""
        return tuple(camera.name for camera in self.cameras)

    def camera(self, name: str) -> Camera:
        """The camera called ``name``; raises :class:`~soar.errors.ArtifactError` for another name."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise ArtifactError(f"sequence {self.name} has no camera {name!r}", expected=", ".join(self.names))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write ``sequence.json``."""
        value = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        value["cameras"] = [camera.to_json() for camera in self.cameras]
        value["sources"] = [dataclasses.asdict(source) for source in self.sources]
        value["subject"] = dataclasses.asdict(self.subject)
        write_json(path, value)

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Sequence:
        """Read ``sequence.json``; raises :class:`~soar.errors.ArtifactError` for a missing or malformed entry."""
        value = read_json(path)
        try:
            subject = value["subject"]
            return Sequence(
                name=value["name"],
                fps=value["fps"],
                frame_ids=tuple(value["frame_ids"]),
                up=np.asarray(value["up"], np.float64),
                train=tuple(value["train"]),
                eval=tuple(value["eval"]),
                cameras=tuple(Camera.from_json(camera) for camera in value["cameras"]),
                sources=tuple(Source(**source) for source in value["sources"]),
                subject=Subject(**{**subject, "point": _tuple(subject["point"]), "box": _tuple(subject["box"])}),
                remarks=tuple(value["remarks"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ArtifactError(
                f"{path} is not a sequence record: {error!r}",
                cure="delete the file and run snakemake; it is made again",
            ) from error


def read_calibrated(path: str | os.PathLike[str], name: str) -> Camera:
    """The refined camera called ``name`` of ``calibration.json``.

    Raises:
        ArtifactError: the file is missing, malformed, or has no such camera.
    """
    value = read_json(path)
    for entry in value.get("cameras", ()) if isinstance(value, Mapping) else ():
        if (camera := Camera.from_json(entry)).name == name:
            return camera
    raise ArtifactError(f"{path} has no camera {name!r}", cure="delete the file and run snakemake; it is made again")


def unit_up(value: Any, where: str) -> np.ndarray:
    """(3,) unit vector of ``value``; raises :class:`~soar.errors.CalibrationError` when it is no direction."""
    try:
        up = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        up = np.zeros(0)
    if up.shape != (3,) or not np.isfinite(up).all() or np.linalg.norm(up) < 1e-9:
        raise CalibrationError(
            f"{where}: up is no direction", expected="three numbers, such as [0, 0, 1]", got=str(value)
        )
    return up / np.linalg.norm(up)


def _tuple(value: list[float] | None) -> Any:
    return None if value is None else tuple(value)
