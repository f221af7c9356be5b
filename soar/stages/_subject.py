"""What the stages that fit the body read: cameras, keypoints, masks, frames of one subject."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path

from soar.artifacts import ImageArchive
from soar.body.observations import Observations
from soar.datasets.sequence import Sequence, read_calibrated
from soar.errors import ArtifactError, SubjectError
from soar.geometry.cameras import Camera
from soar.perception.keypoints import Keypoints
from soar.perception.mapping import metric_body


@dataclasses.dataclass(frozen=True)
class Subject:
    """Keypoints, and lazily decoded masks and frames, of some cameras of a sequence."""

    seen: Observations
    masks: Mapping[str, ImageArchive]
    frames: Mapping[str, ImageArchive]


def observe(inputs: Mapping[str, Path], cameras: Iterable[Camera], min_confidence: float) -> Observations:
    """Keypoints of ``cameras`` from the folder ``keypoints``.

    Raises:
        SubjectError, CalibrationError, ArtifactError: see :meth:`Observations.gather`.
    """
    cameras = tuple(cameras)
    records = [Keypoints.read(inputs["keypoints"] / f"{c.name}.npz") for c in cameras]
    return Observations.gather(
        cameras, [r.keypoints for r in records], [metric_body(r.world) for r in records], min_confidence
    )


def calibrated(inputs: Mapping[str, Path], sequence: Sequence) -> tuple[Camera, ...]:
    """The sequence's cameras with their refined poses."""
    return tuple(read_calibrated(inputs["calibration"], name) for name in sequence.names)


def archives(folder: Path, names: Iterable[str], frames: int) -> dict[str, ImageArchive]:
    """The image archives ``folder/{name}.zip``.

    Raises:
        ArtifactError: one has another number of images than the sequence has frames.
        SubjectError: the sequence has no frames.
    """
    if frames == 0:
        raise SubjectError("the sequence has no frames", cure="choose a longer clip or another frame range")
    return {name: archive(folder / f"{name}.zip", frames) for name in names}


def archive(path: Path, frames: int, plane: str = "") -> ImageArchive:
    """The images of an archive, or of one of its planes.

    Raises:
        ArtifactError: it does not hold an image for each of the sequence's ``frames``.
    """
    found = ImageArchive(path, plane)
    if len(found) != frames:
        raise ArtifactError(
            f"{path} does not belong to this sequence", expected=f"{frames} images {plane}".strip(),
            got=str(len(found)), cure="delete the file and run snakemake; it is made again",
        )  # fmt: skip
    return found
