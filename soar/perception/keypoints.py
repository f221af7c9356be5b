"""The record of one subject's keypoints in one camera, and what every estimator of it must offer."""

from __future__ import annotations

import dataclasses
import os
from typing import Protocol

import numpy as np

from soar.artifacts import read_npz, write_npz


class Frames(Protocol):
    """A clip: (H, W, 3) uint8 RGB frames by index, all of one size, decoded one at a time."""

    def __len__(self) -> int:
        """Number of frames."""

    def __getitem__(self, index: int) -> np.ndarray:
        """One frame."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """What the user said about the subject, in one frame of one camera.

    Attributes:
        frame: index of the frame.
        point: (x, y) pixels on the person, or None.
        box: (x0, y0, x1, y1) pixels around the person, or None.
    """

    frame: int
    point: tuple[float, float] | None
    box: tuple[float, float, float, float] | None


@dataclasses.dataclass(frozen=True)
class Keypoints:
    """One subject over T frames of one camera; zeros in frames where they were not found.

    Attributes:
        keypoints: (T, 137, 3) float32 x, y in pixels and confidence in [0, 1], OpenPose order.
        world: (T, 33, 3) float32 BlazePose landmarks in metres, origin between the hips, x right, y down, z away.
        roi: (T, 4) float32 centre x, y and side in pixels, rotation in radians, of the square
            around the body, turned with its lean; side 0 where not found.
        score: (T,) float32 presence in [0, 1], also of frames in which it was too low.
        disagreement: (T, 25) float32 distance between the direct and the mirrored pass, pixels; zero without a second.
        others: (T, P, 5) float32 people near the subject: their regions as ``roi``, and 1 where they were seen, 0 where
            they are hidden and expected. At most P in a frame; side 0 for the rest.
    """

    keypoints: np.ndarray
    world: np.ndarray
    roi: np.ndarray
    score: np.ndarray
    disagreement: np.ndarray
    others: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 5), np.float32))

    def __post_init__(self) -> None:
        if not self.others.size:
            object.__setattr__(self, "others", np.zeros((len(self.score), 0, 5), np.float32))

    @property
    def present(self) -> np.ndarray:
        """(T,) bool, whether the subject was found."""
        return self.roi[:, 2] > 0

    @property
    def company(self) -> np.ndarray:
        """(T,) bool, whether somebody else was near the subject."""
        return np.any(self.others[..., 2] > 0, axis=1)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write ``keypoints/{camera}.npz``."""
        write_npz(path, {k: v.astype(np.float32) for k, v in dataclasses.asdict(self).items()})

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Keypoints:
        """Read ``keypoints/{camera}.npz``."""
        return Keypoints(**read_npz(path, [f.name for f in dataclasses.fields(Keypoints)]))


@dataclasses.dataclass(frozen=True)
class TrackReport:
    """What happened while the keypoints were made.

    Attributes:
        start: index of the frame from which the subject was followed.
        rivalry: see :class:`soar.perception.subject.Start`.
        reacquired: frames in which the detector had to find the subject again.
        swapped: (T, 3) bool, left/right exchanges undone for head, arms and legs.
        remarks: sentences the user should read.
    """

    start: int
    rivalry: float
    reacquired: int
    swapped: np.ndarray
    remarks: tuple[str, ...]


class KeypointProvider(Protocol):
    """An estimator of 137 keypoints of one subject."""

    def __call__(self, frames: Frames, choice: Choice | None) -> tuple[Keypoints, TrackReport]:
        """Estimate a clip of one camera.

        Args:
            frames: the clip.
            choice: the user's word on who the subject is, if any.

        Raises:
            SubjectError: nobody, several equally likely people, or too little of one person in view.
        """
