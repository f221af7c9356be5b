"""From people detected in every frame to one who is followed: chosen, tracked, and refused where that is in doubt."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Generic

import numpy as np

from soar.errors import SubjectError
from soar.perception import subject
from soar.perception.detector import Person
from soar.perception.keypoints import Choice
from soar.perception.roi import Roi
from soar.perception.subject import Start, SubjectSettings
from soar.perception.tracking import ObservedT, SeenT, Track, TrackingSettings, nearest, track


@dataclasses.dataclass(frozen=True)
class FollowSettings:
    """Who is followed, how, and when the result is refused.

    Attributes:
        min_frames: frames the clip needs, and in which the subject must be found.
        min_tracked: share of the clip's frames in which the subject must be found.
        subject: how the subject is chosen.
        tracking: how they are followed.
    """

    min_frames: int
    min_tracked: float
    subject: SubjectSettings
    tracking: TrackingSettings


@dataclasses.dataclass(frozen=True)
class Followed(Generic[ObservedT, SeenT]):
    """The start, the track, and what the user should read."""

    start: Start
    track: Track[ObservedT, SeenT]
    remarks: tuple[str, ...]

    @property
    def others(self) -> np.ndarray:
        """(T, P, 5) as :attr:`soar.perception.keypoints.Keypoints.others`."""
        frames = self.track.others
        rows = np.zeros((len(frames), max(map(len, frames)), 5), np.float32)
        for t, people in enumerate(frames):
            for i, other in enumerate(people):
                rows[t, i] = (*dataclasses.astuple(other.roi), other.seen)
        return rows


def follow(
    detections: Sequence[Sequence[Person]],
    size: tuple[int, int],
    choice: Choice | None,
    observe: Callable[[int, Roi], ObservedT],
    glance: Callable[[int, Roi], SeenT],
    settings: FollowSettings,
    progress: Callable[[Iterable[int]], Iterable[int]] = lambda frames: frames,
) -> Followed[ObservedT, SeenT]:
    """Choose one person and follow them.

    Args:
        detections: people of every frame.
        size: width and height of the frames, pixels.
        choice: the user's word on who the subject is, if any.
        observe, glance, progress: see :func:`soar.perception.tracking.track`.
        settings: see there.

    Raises:
        SubjectError: nobody, several equally likely people, or too little of one person in view.
    """
    count = len(detections)
    if count < settings.min_frames:
        raise SubjectError(
            "the clip is too short",
            expected=f"at least {settings.min_frames} frames",
            got=str(count),
            cure="give a longer clip or a smaller dataset frame step",
        )
    start = (
        subject.most_prominent(detections, *size, settings.subject)
        if choice is None
        else subject.chosen(detections, choice)
    )
    followed = track(detections, start, observe, glance, settings.tracking, progress)
    found = sum(o is not None for o in followed.observations)
    if found < max(settings.min_frames, settings.min_tracked * count):
        raise SubjectError(
            "the subject was found in too few frames",
            expected=f"at least {settings.min_tracked:.0%} of {count} frames, and {settings.min_frames} frames",
            got=f"{found} frames, starting from frame {start.frame}",
            cure=f"cut the clip to where the person is in view, or {subject.CHOOSE}",
        )
    remarks = []
    if start.rivalry >= settings.subject.rival_remark:
        remarks.append(
            f"Another person is {start.rivalry:.0%} as prominent as the subject. Look whether the right one is"
            f" followed; otherwise {subject.CHOOSE}."
        )
    return Followed(start, followed, tuple(remarks))


@dataclasses.dataclass(frozen=True)
class Listed:
    """One of the people that something else found in a frame.

    Attributes:
        presence: 1, or 0 where nobody was found in the place that was looked at.
        next_roi: the region around them.
        index: their place in the frame's list.
    """

    presence: float
    next_roi: Roi
    index: int


def follow_listed(
    people: Sequence[Sequence[Person]], size: tuple[int, int], choice: Choice | None, settings: FollowSettings
) -> Followed[Listed, Listed]:
    """Follow one of the people that were found in every frame, whose order tells nothing; errors as :func:`follow`."""

    def look(t: int, roi: Roi) -> Listed:
        place = nearest(people[t], roi, settings.tracking.reacquire_distance)
        if place is None:
            return Listed(0.0, roi, -1)
        return Listed(1.0, place, [person.roi for person in people[t]].index(place))

    return follow(people, size, choice, look, look, settings)
