"""What a reader is told, and what it gives."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from soar.body.parameters import SMPL_PELVIS, HandSpace, SmplxParameters
from soar.errors import InputError
from soar.importers.files import CURE


@dataclasses.dataclass(frozen=True)
class Known:
    """What files of parameters leave unsaid.

    Attributes:
        size: width and height of the images that the tool saw, pixels.
        focal: focal length that it assumed, pixels of those images; None for the tool's own habit.
        hands: what fingers are measured in; None leaves hands out.
    """

    size: tuple[int, int]
    focal: float | None
    hands: HandSpace | None


@dataclasses.dataclass(frozen=True)
class Archive:
    """The people in somebody's files.

    Attributes:
        people: one record each; where the tool does not follow people, one for each place in its lists, in which people
            may change places from frame to frame.
        first: number that the tool gives to the first frame of a recording.

    Raises:
        InputError: the people are of different bodies.
    """

    people: tuple[SmplxParameters, ...]
    first: int = 0

    def __post_init__(self) -> None:
        kinds = {
            tuple(None if value is None else value.shape[1:] for value in (person.betas, person.left_hand, person.face))
            for person in self.people
        }
        if len(kinds) > 1:
            raise InputError("body parameters: the people are of different bodies", got=str(kinds), cure=CURE)

    @property
    def of_camera(self) -> bool:
        """Whether the parameters are in the axes of a camera."""
        return any(person.frame == "camera" for person in self.people)


class Reader(Protocol):
    """Reads the files of one tool."""

    def __call__(self, path: Path, known: Known) -> Archive:
        """The people in a file or folder.

        Raises:
            InputError: files are missing, damaged, or not of this tool.
        """


def pinhole(size: tuple[int, int], focal: float) -> np.ndarray:
    """(3, 3) intrinsics with the principal point in the middle of the image."""
    return np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])


def stacked(rows: Mapping[int, Mapping[str, np.ndarray]], path: Path) -> dict[str, np.ndarray]:
    """Fields of single frames, by frame number, as fields (T, ...) in the order of ``frames`` (T,).

    Raises:
        InputError: a field has different shapes in different frames.
    """
    frames = sorted(rows)
    fields = {"frames": np.array(frames)}
    for name in rows[frames[0]]:
        shapes = {rows[frame][name].shape for frame in frames}
        if len(shapes) > 1:
            raise InputError(f"{path}: {name} has another shape in other frames", got=str(sorted(shapes)), cure=CURE)
        fields[name] = np.stack([rows[frame][name] for frame in frames])
    return fields


def from_smpl(
    frames: np.ndarray, pose: np.ndarray, translation: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> SmplxParameters:
    """SMPL's parameters in the axes of a camera: the 21 body joints are SMPL-X's, its hand joints and betas are not.

    Args:
        frames: (T,) numbers.
        pose: (T, 72) axis-angle.
        translation: (T, 3) added last, metres.
        K: (3, 3) or (T, 3, 3).
        size: of the images.
    """
    T = len(frames)
    return SmplxParameters(
        frames=frames, global_orient=pose[:, :3], body_pose=pose[:, 3:66].reshape(T, 21, 3), translation=translation,
        lever=np.tile(np.eye(3), (T, 1, 1)), frame="camera", K=np.broadcast_to(K, (T, 3, 3)), size=size,
        rest_pelvis=np.array(SMPL_PELVIS),
    )  # fmt: skip


def somebody(people: Sequence[SmplxParameters], path: Path) -> tuple[SmplxParameters, ...]:
    """The people, of whom there must be one."""
    if not people:
        raise InputError(f"{path} holds no person", cure="correct body.source")
    return tuple(people)
