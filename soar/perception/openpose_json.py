"""Keypoints that OpenPose wrote: a folder of JSON files, one a frame, with everybody in it in no particular order."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from soar.body.openpose import BODY, COUNT, FACE, LEFT_HAND, RIGHT_HAND
from soar.datasets import adapter
from soar.datasets.ingest import undistort_points
from soar.datasets.sequence import Sequence as Clip
from soar.errors import InputError
from soar.geometry.cameras import Camera
from soar.perception.brought import brought_file
from soar.perception.detector import Person
from soar.perception.following import FollowSettings, follow_listed
from soar.perception.keypoints import Choice, Frames, Keypoints, TrackReport
from soar.perception.lift import LiftSettings, body_region, lift
from soar.perception.pose import PoseNetwork
from soar.perception.roi import Roi
from soar.perception.swaps import SwapSettings

SUFFIX = "_keypoints.json"
LARGEST = 1 << 24  # bytes of one file: that of a thousand people
PARTS = {
    "pose_keypoints_2d": slice(0, len(BODY)),
    "hand_left_keypoints_2d": LEFT_HAND,
    "hand_right_keypoints_2d": RIGHT_HAND,
    "face_keypoints_2d": FACE,
}
_MODELS = {54: "18 keypoints (COCO)", 57: "19 keypoints (BODY_19)", 45: "15 keypoints (MPI)", 0: "no body"}


@dataclasses.dataclass(frozen=True)
class OpenPoseSettings(FollowSettings):
    """Settings of :class:`OpenPoseKeypoints`; see ``conf/keypoints/openpose.yaml``."""

    provider: Literal["openpose"]
    source: str | None
    dataset: dict[str, Any]
    made_of: Literal["recording", "frames"]
    first_number: int
    min_inside: float
    lift: LiftSettings
    swaps: SwapSettings


class OpenPoseKeypoints:
    """One subject of OpenPose's files; implements :class:`~soar.perception.keypoints.KeypointProvider`.

    Args:
        settings: see the conf file.
        files: ``source``, the folder of one camera; the folder ``models`` of our own networks.
        threads: threads of one inference.
        sequence: the frames they belong to.
        camera: name of the camera.

    Raises:
        ConfigError: no folder is named.
        ModelFileError: BlazePose is missing or corrupt.
    """

    def __init__(
        self, settings: OpenPoseSettings, files: Mapping[str, Path], threads: int, sequence: Clip, camera: str
    ) -> None:
        self._settings, self._source = settings, brought_file(files, "source", "keypoints")
        models = Path(files["models"])
        self._pose = PoseNetwork(models / f"pose_landmark_{settings.lift.model}.onnx", threads)
        self._ids, self._numbers = sequence.frame_ids, list(range(len(sequence)))
        self._camera = self._stored = sequence.camera(camera)
        if settings.made_of == "recording":
            capture = adapter(settings.dataset).capture(sequence.name)
            self._camera = next(entry for entry in capture.cameras if entry.name == camera)
            own = capture.recordings[camera].probe.numbers
            self._numbers = [settings.first_number + t if own is None else own[t] for t in sequence.frame_ids]
        else:
            self._numbers = [settings.first_number + t for t in self._numbers]

    def __call__(self, frames: Frames, choice: Choice | None) -> tuple[Keypoints, TrackReport]:
        """See :meth:`soar.perception.keypoints.KeypointProvider.__call__`.

        Raises:
            InputError: files that are no keypoints of these frames; see :func:`read_folder` and :func:`read_people`.
        """
        everybody, remarks = self._everybody()
        listed = [[Person(float(k[: len(BODY), 2].mean()), region) for k, region in people] for people in everybody]
        height, width = frames[0].shape[:2]
        followed = follow_listed(listed, (width, height), choice, self._settings)
        chosen = np.zeros((1, len(frames), COUNT, 3))
        for t, seen in enumerate(followed.track.observations):
            if seen is not None:
                chosen[0, t] = everybody[t][seen.index][0]
        record, swapped, more = lift(
            frames, chosen, followed.others, self._pose, self._settings.lift, self._settings.swaps, math.inf
        )
        start, track = followed.start, followed.track
        every = (*remarks, *followed.remarks, *more)
        return record, TrackReport(start.frame, start.rivalry, track.reacquired, swapped, every)

    def _everybody(self) -> tuple[list[list[tuple[np.ndarray, Roi]]], list[str]]:
        """Keypoints (137, 3) in pixels of the stored frame and region of everybody in every frame, and remarks."""
        files, remarks = read_folder(self._source), []
        missing = [i for i, number in zip(self._ids, self._numbers, strict=True) if number not in files]
        if len(missing) == len(self._ids):
            raise InputError(
                f"{self._source} has no keypoints of these frames",
                expected=f"files numbered {self._numbers[0]} to {self._numbers[-1]}",
                got=f"{min(files)} to {max(files)}",
                cure="set keypoints.first_number, or keypoints.made_of",
            )
        if missing:
            remarks.append(
                f"{self._source} has no file for {len(missing)} of {len(self._ids)} frames, the first being frame"
                f" {missing[0]}; nobody counts as seen there."
            )
        empty = np.zeros((0, COUNT, 3))
        people = [read_people(files[number]) if number in files else empty for number in self._numbers]
        people, scale = in_pixels(people, self._camera)
        if scale:
            remarks.append(f"The keypoints are given {scale}, and were taken as such.")
        self._check_inside(people)
        placed = [[(k, body_region(k[: len(BODY)])) for k in self._placed(p)] for p in people]
        return [[(k, region) for k, region in found if region is not None] for found in placed], remarks

    def _check_inside(self, people: Sequence[np.ndarray]) -> None:
        every = np.concatenate([p.reshape(-1, 3) for p in people])
        seen = every[every[:, 2] > 0, :2]
        size = self._camera.width, self._camera.height
        inside = ((seen >= 0) & (seen <= size)).all(1)
        if len(seen) and inside.mean() < self._settings.min_inside:
            raise InputError(
                f"{self._source}: the keypoints lie outside of the {self._settings.made_of}",
                expected=f"{self._settings.min_inside:.0%} of them within {size[0]}x{size[1]} pixels",
                got=f"{inside.mean():.0%}; they reach from {seen.min(0).round(1)} to {seen.max(0).round(1)}",
                cure="run OpenPose on this very footage, with --keypoint_scale 0; or set keypoints.made_of",
            )

    def _placed(self, people: np.ndarray) -> np.ndarray:
        """Keypoints of the recording, as those of the stored frame: without the lens's distortion, at its size."""
        placed, seen = people.copy(), people[..., 2] > 0
        scale = np.array([self._stored.width / self._camera.width, self._stored.height / self._camera.height])
        if seen.any():
            points = people[seen][:, :2]
            lens = self._camera.distortion.any()
            placed[seen, :2] = (undistort_points(self._camera, points) if lens else points) * scale
        return placed


def read_folder(folder: Path) -> dict[int, Path]:
    """The files of a folder by the number in their names.

    Raises:
        InputError: there are none, one has no number, or two have the same.
    """
    files = sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []
    if not files:
        raise InputError(
            f"{folder} is no folder of OpenPose's keypoints",
            expected=f"files *{SUFFIX}, as `openpose --write_json FOLDER` leaves",
            cure="correct keypoints.source",
        )
    result: dict[int, Path] = {}
    for file in files:
        number = re.search(r"(\d+)$", file.name.removesuffix(SUFFIX))
        if number is None:
            raise InputError(
                f"{file} has no number",
                expected=f"the frame's number before {SUFFIX}",
                cure="take the file out of the folder, or name it by its frame",
            )
        if (other := result.setdefault(int(number[1]), file)) != file:
            raise InputError(f"{file} and {other.name} have the same number", cure="give each camera its own folder")
    return result


def read_people(file: Path) -> np.ndarray:
    """(P, 137, 3) x, y and confidence of everybody in a file, 0 where a keypoint was not found.

    Raises:
        InputError: the file is damaged, of a model of fewer keypoints, or something else.
    """
    try:
        if (size := file.stat().st_size) > LARGEST:
            raise InputError(
                f"{file} is too large",
                expected=f"at most {LARGEST} bytes",
                got=f"{size} bytes",
                cure="take it out of the folder",
            )
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file} is not JSON: {error}", cure="write it again; it may be truncated") from error
    people = content.get("people") if isinstance(content, dict) else None
    if not isinstance(people, list) or not all(isinstance(person, dict) for person in people):
        raise InputError(
            f"{file} is no file of OpenPose's",
            expected='{"people": [{"pose_keypoints_2d": [...]}, ...]}',
            cure="take it out of the folder, or write it again",
        )
    return np.array(list(_people(file, people))).reshape(-1, COUNT, 3)


def _people(file: Path, people: list[dict[str, Any]]) -> Iterator[np.ndarray]:
    for person in people:
        keypoints = np.zeros((COUNT, 3))
        for key, members in PARTS.items():
            values = _numbers(file, key, person.get(key, []))
            expected = 3 * (members.stop - members.start)
            body = key == "pose_keypoints_2d"
            if len(values) != expected and (body or len(values)):
                what = _MODELS.get(len(values), f"{len(values)} numbers") if body else f"{len(values)} numbers"
                raise InputError(
                    f"{file}: {key} has {what}",
                    expected=f"{expected} numbers" + (", the model BODY_25" if body else ", or none"),
                    got=f"{len(values)} numbers",
                    cure="run OpenPose with --model_pose BODY_25, its default",
                )
            if len(values):
                keypoints[members] = values.reshape(-1, 3)
        keypoints[:, 2] = keypoints[:, 2].clip(0, 1)
        keypoints[keypoints[:, 2] == 0] = 0
        yield keypoints


def _numbers(file: Path, key: str, values: Any) -> np.ndarray:
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.full(1, np.nan)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise InputError(
            f"{file}: {key} is no list of numbers",
            expected="x, y, confidence, x, y, confidence, ...",
            cure="write the file again with OpenPose",
        )
    return numbers


def in_pixels(people: Sequence[np.ndarray], camera: Camera) -> tuple[list[np.ndarray], str]:
    """Keypoints (P, 137, 3) of every frame in pixels, and in which other unit they were: "" for pixels.

    OpenPose writes shares of the picture with ``--keypoint_scale`` 3, from 0 to 1, and 4, from -1 to 1. Nobody is two
    pixels high, so the numbers tell.
    """
    every = np.concatenate([p.reshape(-1, 3) for p in people])
    seen = every[every[:, 2] > 0, :2]
    if not len(seen) or np.abs(seen).max() > 1:
        return list(people), ""
    low = -1.0 if seen.min() < 0 else 0.0
    size = np.array([camera.width, camera.height])
    converted = []
    for p in people:
        places = (p[..., :2] - low) / (1 - low) * size
        converted.append(np.concatenate([np.where(p[..., 2:] > 0, places, 0), p[..., 2:]], -1))
    return converted, f"in shares of the picture, from {low:g} to 1"
