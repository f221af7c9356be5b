"""What every dataset lets the user select: frames, their size, the camera split, and whom to follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

from soar.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class FrameSettings:
    """Which frames of a recording are used. Frame numbers count from 0 in the recording.

    Attributes:
        start, stop: first frame, and the frame before which to stop; None is the end.
        stride: every how many frames one is kept.
        max_frames: most frames to keep, counted from ``start``; None keeps all.
        min_frames: fewest frames worth working on.
        fps: rate of the recording, frames per second, before the stride; None takes the recording's own.
        long_side: longest side of the stored frames, pixels; larger ones are resampled; None keeps the size.
        count_tolerance: how many frames a recording may hold less than its container or another camera promises.
        jpeg_quality: quality of the stored frames, 1 to 100.
    """

    start: int
    stop: int | None
    stride: int
    max_frames: int | None
    min_frames: int
    fps: float | None
    long_side: int | None
    count_tolerance: int
    jpeg_quality: int


@dataclasses.dataclass(frozen=True)
class SubjectSettings:
    """Whom to follow, where the largest, most central person is the wrong one.

    Attributes:
        point: (x, y) on the person, pixels of the recording as a player shows it.
        box: (x0, y0, x1, y1) around the person, likewise.
        frame: the recording's frame in which point or box are given; None is the first one used.
        stature_m: body height in metres, where known; it fixes the scale of a single-camera clip.
    """

    point: tuple[float, float] | None
    box: tuple[float, float, float, float] | None
    frame: int | None
    stature_m: float | None


def check_split(train: tuple[str, ...], evaluation: tuple[str, ...], known: Collection[str], where: str) -> None:
    """Check a training/evaluation split against the cameras there are.

    Raises:
        ConfigError: no training camera, an unknown camera, or one that stands twice.
    """
    both = [*train, *evaluation]
    if not train or set(both) - set(known) or len(set(both)) < len(both):
        raise ConfigError(
            f"the camera split does not fit {where}",
            expected=f"at least one training camera, none twice, all from {', '.join(known)}",
            got=f"train {list(train)}, eval {list(evaluation)}",
            cure="set for instance \"overrides=['dataset.train=[NAME]']\"",
        )
