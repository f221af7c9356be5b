"""Following one subject through a clip, forwards and backwards from the frame where they are seen best."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

from soar.perception.detector import Person
from soar.perception.roi import Roi
from soar.perception.subject import Start


@dataclasses.dataclass(frozen=True)
class TrackingSettings:
    """When the subject counts as present, and where to look after losing them."""

    min_presence: float
    reacquire_distance: float


class Observed(Protocol):
    """What the tracker needs of one frame's estimate."""

    @property
    def presence(self) -> float:
        """Probability in [0, 1] that the region showed a person."""

    @property
    def next_roi(self) -> Roi:
        """Where to look in a neighbouring frame, turned with the whole lean of the body."""


ObservedT = TypeVar("ObservedT", bound=Observed)


@dataclasses.dataclass(frozen=True)
class Track(Generic[ObservedT]):
    """One subject over a clip.

    Attributes:
        observations: (T,) estimates; None where the subject was not found.
        presence: (T,) best presence seen in the frame, also where it was too low.
        reacquired: frames in which the detector had to find the subject again.
    """

    observations: list[ObservedT | None]
    presence: list[float]
    reacquired: int


def nearest(people: Sequence[Person], last: Roi, max_distance: float) -> Roi | None:
    """Region of the person nearest to ``last``, at most ``max_distance`` of its sides away and of similar size."""
    near = [
        (math.hypot(p.roi.cx - last.cx, p.roi.cy - last.cy) / last.side, p.roi)
        for p in people
        if 0.5 <= p.roi.side / last.side <= 2
    ]
    distance, roi = min(near, key=lambda n: n[0], default=(math.inf, None))
    return roi if distance <= max_distance else None


def track(
    detections: Sequence[Sequence[Person]],
    start: Start,
    observe: Callable[[int, Roi], ObservedT],
    settings: TrackingSettings,
    progress: Callable[[Iterable[int]], Iterable[int]] = lambda frames: frames,
) -> Track[ObservedT]:
    """Estimate every frame in the region that the neighbouring frame's estimate proposes.

    Where presence falls below ``settings.min_presence`` the detection nearest to the last known region is tried
    instead; failing that the frame stays empty and the last region is kept. Regions are not smoothed in time.

    Args:
        detections: people of every frame.
        start: frame and region to start from.
        observe: the estimator, of a frame index and a region.
        settings: thresholds.
        progress: wrapper around each sequence of frames, for a progress bar.
    """
    count = len(detections)
    observations: list[ObservedT | None] = [None] * count
    presence = [0.0] * count
    reacquired = 0
    for frames in (range(start.frame, count), range(start.frame - 1, -1, -1)):
        first = observations[start.frame]
        roi = start.roi if first is None else first.next_roi
        for t in progress(frames):
            seen = observe(t, roi)
            if seen.presence < settings.min_presence:
                again = nearest(detections[t], roi, settings.reacquire_distance)
                if again is not None and again != roi:
                    retry = observe(t, again)
                    reacquired += retry.presence >= settings.min_presence
                    seen = retry if retry.presence > seen.presence else seen
            presence[t] = seen.presence
            if seen.presence >= settings.min_presence:
                observations[t] = seen
                roi = seen.next_roi if seen.next_roi.usable else roi
    return Track(observations, presence, reacquired)
