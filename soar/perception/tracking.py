"""Following one subject through a clip, forwards and backwards from the frame where they are seen best.

An estimator that looks at a region reports whoever is most visible there. When people pass each other, the estimates of
both become one: that of the person in front. So the other people who come near the subject are followed as well; where
two estimates coincide one of the two people is hidden, and they are expected to walk on behind the other until an
estimate of their own is to be had again. Who of them was hidden is told when it begins, by who would have had to jump.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

from soar.perception.detector import Person
from soar.perception.roi import Roi
from soar.perception.subject import Start

_SIGHTINGS = 5  # over which the pace is measured


@dataclasses.dataclass(frozen=True)
class TrackingSettings:
    """When the subject counts as present, where to look after losing them, and when two estimates show one person.

    Attributes:
        min_presence: probability in [0, 1] below which a person is lost.
        reacquire_distance: in sides of the last region: how far away a lost person may reappear.
        same_person: in sides of a region: estimates of two people whose centres are nearer than this show one of them.
        memory: frames for which a hidden person is expected to walk on at their pace, and another person is remembered.
    """

    min_presence: float
    reacquire_distance: float
    same_person: float
    memory: int


class Observed(Protocol):
    """What the tracker needs of one frame's estimate."""

    @property
    def presence(self) -> float:
        """Probability in [0, 1] that the region showed a person."""

    @property
    def next_roi(self) -> Roi:
        """Where to look in a neighbouring frame, turned with the whole lean of the body."""


ObservedT = TypeVar("ObservedT", bound=Observed)
SeenT = TypeVar("SeenT", bound=Observed)
EstimateT = TypeVar("EstimateT", bound=Observed)


@dataclasses.dataclass(frozen=True)
class Other(Generic[SeenT]):
    """Somebody else near the subject in one frame.

    Attributes:
        roi: the region they were seen in or, hidden, are expected in.
        seen: whether they were seen.
        estimate: what was estimated there; None for a mere detection too.
    """

    roi: Roi
    seen: bool
    estimate: SeenT | None


@dataclasses.dataclass(frozen=True)
class Track(Generic[ObservedT, SeenT]):
    """One subject over a clip.

    Attributes:
        observations: (T,) estimates; None where the subject was not found.
        presence: (T,) best presence seen in the frame, also where it was too low.
        reacquired: frames in which the detector had to find the subject again.
        others: (T,) the people near the subject.
    """

    observations: list[ObservedT | None]
    presence: list[float]
    reacquired: int
    others: list[tuple[Other[SeenT], ...]]


def _distance(a: Roi, b: Roi) -> float:
    """Distance of the centres of two regions, in sides of ``b``."""
    return math.hypot(a.cx - b.cx, a.cy - b.cy) / max(b.side, 1.0)


def nearest(people: Sequence[Person], last: Roi, max_distance: float) -> Roi | None:
    """Region of the person nearest to ``last``, at most ``max_distance`` of its sides away and of similar size."""
    near = [(_distance(p.roi, last), p.roi) for p in people if 0.5 <= p.roi.side / last.side <= 2]
    distance, roi = min(near, key=lambda n: n[0], default=(math.inf, None))
    return roi if distance <= max_distance else None


@dataclasses.dataclass(frozen=True)
class _Path(Generic[ObservedT]):
    """Where one person was seen last, a few sightings in order, and the estimate of the frame at hand, if any."""

    roi: Roi
    sightings: tuple[tuple[int, Roi], ...] = ()
    seen: ObservedT | None = None

    def went(self, t: int, seen: ObservedT | None, detected: Roi | None = None) -> _Path[ObservedT]:
        """The path with the estimate of frame ``t`` or, failing that, a detection."""
        roi = seen.next_roi if seen is not None and seen.next_roi.usable else detected
        if roi is None:
            return dataclasses.replace(self, seen=seen)
        return _Path(roi, (*self.sightings, (t, roi))[-_SIGHTINGS:], seen)

    def missed(self, t: int) -> int:
        """Frames since the last sighting."""
        return abs(t - self.sightings[-1][0]) if self.sightings else 1

    def expected(self, t: int, memory: int) -> Roi:
        """The last region, moved on at the pace of the last sightings."""
        if len(self.sightings) < 2:
            return self.roi
        (t0, first), (t1, last) = self.sightings[0], self.sightings[-1]
        steps = min(abs(t - t1), memory) / abs(t1 - t0)
        return dataclasses.replace(
            last, cx=last.cx + steps * (last.cx - first.cx), cy=last.cy + steps * (last.cy - first.cy)
        )


class _Tracker(Generic[ObservedT, SeenT]):
    """Everybody in the frame at hand; see :func:`track`."""

    def __init__(
        self,
        detections: Sequence[Sequence[Person]],
        start: Roi,
        observe: Callable[[int, Roi], ObservedT],
        glance: Callable[[int, Roi], SeenT],
        settings: TrackingSettings,
    ) -> None:
        self._detections, self._observe, self._glance, self._settings = detections, observe, glance, settings
        self.subject: _Path[ObservedT] = _Path(start)
        self.others: tuple[_Path[SeenT], ...] = ()
        self.presence, self.reacquired = 0.0, False

    def step(self, t: int) -> None:
        """Go on to frame ``t``."""
        settings, subject = self._settings, self.subject
        expected = subject.expected(t, settings.memory)
        places = [other.expected(t, settings.memory) for other in self.others]
        near = [place.overlap(expected) > 0 for place in places]
        # Alone, the subject is looked for where the last estimate proposes, however long ago that was.
        region = expected if any(near) else subject.roi
        found = self._look(t, region)
        free = self._unclaimed(self._detections[t], region if found is None else found.next_roi)
        glances = [self._seen(self._glance(t, place)) if n else None for place, n in zip(places, near, strict=True)]
        for i, other in enumerate(self.others):
            glance = glances[i]
            if found is None or glance is None or not self._one_person(found, glance):
                continue
            if self._jump(t, subject, found) <= self._jump(t, other, glance):
                glances[i] = self._elsewhere(t, (places[i], other.roi), free, self._glance, [found])
            else:
                self.presence = 0.0
                taken = [g for g in glances if g is not None]
                found = self._elsewhere(t, (expected, subject.roi), free, self._observe, taken)
        self.subject = subject.went(t, found)
        others = []
        for other, place, glance in zip(self.others, places, glances, strict=True):
            others.append(other.went(t, glance, nearest(free, place, settings.reacquire_distance)))
            free = self._unclaimed(free, others[-1].roi)
        if found is not None:
            self.presence = found.presence
            others += self._met(t, free, found)
        self.others = tuple(other for other in others if other.missed(t) <= settings.memory)

    def company(self, t: int) -> tuple[Other[SeenT], ...]:
        """Everybody else whose region meets the subject's."""
        memory = self._settings.memory
        own = self.subject.expected(t, memory)
        places = [Other(other.expected(t, memory), other.missed(t) == 0, other.seen) for other in self.others]
        return tuple(place for place in places if place.roi.overlap(own) > 0)

    def _seen(self, estimate: EstimateT) -> EstimateT | None:
        return estimate if estimate.presence >= self._settings.min_presence else None

    def _one_person(self, a: Observed, b: Observed) -> bool:
        return _distance(a.next_roi, b.next_roi) < self._settings.same_person

    def _jump(self, t: int, path: _Path, seen: Observed) -> float:
        """How far, in sides, an estimate lies from where its person was expected; infinite if they were hidden."""
        if path.missed(t) > 1:
            return math.inf
        return _distance(seen.next_roi, path.expected(t, self._settings.memory))

    def _look(self, t: int, region: Roi) -> ObservedT | None:
        """The subject's estimate in the region or, where nobody is there, at the nearest detection."""
        settings, best = self._settings, self._observe(t, region)
        self.reacquired = False
        if best.presence < settings.min_presence:
            again = nearest(self._detections[t], region, settings.reacquire_distance)
            if again is not None and again != region:
                retry = self._observe(t, again)
                self.reacquired = retry.presence >= settings.min_presence
                best = retry if retry.presence > best.presence else best
        self.presence = best.presence
        return self._seen(best)

    def _elsewhere(
        self,
        t: int,
        places: Sequence[Roi],
        free: Sequence[Person],
        look: Callable[[int, Roi], EstimateT],
        taken: Sequence[Observed],
    ) -> EstimateT | None:
        """The estimate at a detection near one of the places, of those who walk on or stay, that shows nobody taken."""
        for place in places:
            left = list(free)
            while (again := nearest(left, place, self._settings.reacquire_distance)) is not None:
                left = [person for person in left if person.roi != again]
                seen = self._seen(look(t, again))
                if seen is not None and not any(self._one_person(seen, other) for other in taken):
                    return seen
        return None

    def _unclaimed(self, people: Sequence[Person], place: Roi) -> list[Person]:
        """The detections but the one nearest to ``place``."""
        own = nearest(people, place, self._settings.reacquire_distance)
        return [person for person in people if person.roi != own]

    def _met(self, t: int, free: Sequence[Person], found: Observed) -> list[_Path[SeenT]]:
        """People who were not known yet. Nobody is met while the subject is hidden: it might be them."""
        met: list[_Path[SeenT]] = []
        for person in free:
            seen = self._seen(self._glance(t, person.roi))
            if seen is not None and not self._one_person(seen, found):
                met.append(_Path[SeenT](person.roi).went(t, seen))
        return met


def track(
    detections: Sequence[Sequence[Person]],
    start: Start,
    observe: Callable[[int, Roi], ObservedT],
    glance: Callable[[int, Roi], SeenT],
    settings: TrackingSettings,
    progress: Callable[[Iterable[int]], Iterable[int]] = lambda frames: frames,
) -> Track[ObservedT, SeenT]:
    """Estimate every frame in the region that the neighbouring frame's estimate proposes.

    Where presence falls below ``settings.min_presence`` the detection nearest to the last known region is tried
    instead; failing that, or where somebody else stands there, the frame stays empty and the region moves on at the
    subject's pace. Regions are not smoothed in time.

    Args:
        detections: people of every frame.
        start: frame and region to start from.
        observe: the estimator, of a frame index and a region.
        glance: the same or a cheaper one, for the people near the subject.
        settings: thresholds.
        progress: wrapper around each sequence of frames, for a progress bar.
    """
    count = len(detections)
    observations: list[ObservedT | None] = [None] * count
    others: list[tuple[Other[SeenT], ...]] = [()] * count
    presence, reacquired = [0.0] * count, 0
    tracker = _Tracker(detections, start.roi, observe, glance, settings)
    first = tracker.subject, tracker.others
    for frames in (range(start.frame, count), range(start.frame - 1, -1, -1)):
        tracker.subject, tracker.others = first
        for t in progress(frames):
            tracker.step(t)
            if t == start.frame:
                first = tracker.subject, tracker.others
            observations[t], presence[t] = tracker.subject.seen, tracker.presence
            others[t] = tracker.company(t)
            reacquired += tracker.reacquired
    return Track(observations, presence, reacquired, others)
