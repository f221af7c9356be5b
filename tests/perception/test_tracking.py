"""Following a subject with a stand-in estimator whose person moves on a known path."""

from __future__ import annotations

import dataclasses

import pytest

from soar.config import settings
from soar.perception.detector import Person
from soar.perception.roi import Roi
from soar.perception.subject import Start
from soar.perception.tracking import TrackingSettings, nearest, track
from tests.conftest import conf

OPTIONS = settings(TrackingSettings, conf("keypoints", "mediapipe")["tracking"])


@dataclasses.dataclass(frozen=True)
class Seen:
    """An estimate: where the person truly is."""

    presence: float
    next_roi: Roi


@dataclasses.dataclass
class World:
    """A person moving 10 pixels per frame, hidden in some frames; the estimator finds them within half a region."""

    hidden: tuple[int, ...] = ()
    jump: int = 0
    tried: list[tuple[int, Roi]] = dataclasses.field(default_factory=list)

    def at(self, t: int) -> Roi:
        return Roi(200.0 + 10 * t + (self.jump if t >= 5 else 0), 300.0, 200.0, 0.4)

    def observe(self, t: int, roi: Roi) -> Seen:
        self.tried.append((t, roi))
        there = self.at(t)
        near = abs(there.cx - roi.cx) < roi.side / 2 and t not in self.hidden
        return Seen(0.95 if near else 0.2, there if near else Roi(0, 0, 1, 0))


def _follow(world: World, start: int, detections: dict[int, Roi] | None = None, count: int = 10):
    people = [[Person(0.9, detections[t])] if detections and t in detections else [] for t in range(count)]
    return track(people, Start(start, world.at(start), 0.0), world.observe, world.observe, OPTIONS)


def test_both_ways_from_the_start_in_the_neighbours_region():
    world = World()
    result = _follow(world, 4)
    assert all(o is not None for o in result.observations)
    assert result.reacquired == 0
    assert [t for t, _ in world.tried] == [4, 5, 6, 7, 8, 9, 3, 2, 1, 0]
    regions = dict(world.tried)
    assert regions[7].cx == world.at(6).cx
    assert regions[3].cx == world.at(4).cx


def test_hidden_frames_stay_empty_and_the_last_region_is_kept():
    result = _follow(World(hidden=(5, 6)), 0)
    assert [o is None for o in result.observations] == [t in (5, 6) for t in range(10)]
    assert result.presence[5] == 0.2
    assert result.presence[4] == 0.95


def test_a_lost_subject_is_found_again_by_the_detector():
    world = World(jump=130)
    assert _follow(world, 0).observations[5] is None
    result = _follow(world, 0, {t: world.at(t) for t in range(10)})
    assert all(o is not None for o in result.observations)
    assert result.reacquired == 1
    assert not any(result.others)


def test_nearest_ignores_people_far_away_or_of_another_size():
    last = Roi(500, 500, 200, 0)
    near, far, tiny = (Person(0.9, Roi(x, 500, s, 0)) for x, s in ((560, 210), (900, 200), (510, 60)))
    assert nearest([far, tiny, near], last, 0.75) == near.roi
    assert nearest([far, tiny], last, 0.75) is None
    assert nearest([], last, 0.75) is None


@dataclasses.dataclass
class Crossing:
    """Two people walk past each other; the estimator reports the one in front wherever both are in reach.

    The detector, too, sees one person while they are close. ``back``: both turn round when they meet.
    """

    front: int
    back: bool = False

    def at(self, who: int, t: int) -> Roi:
        way = t if not self.back or t < 10 else 20 - t
        return Roi((300 + 20.0 * way, 700 - 20.0 * way)[who], 300.0, 200.0, 0.0)

    def observe(self, t: int, roi: Roi) -> Seen:
        places = [self.at(who, t) for who in (self.front, 1 - self.front)]
        near = [place for place in places if abs(place.cx - roi.cx) < 60]
        return Seen(0.95, near[0]) if near else Seen(0.1, roi)

    def detections(self, t: int) -> list[Person]:
        places = [self.at(who, t) for who in (self.front, 1 - self.front)]
        close = abs(places[0].cx - places[1].cx) < 150
        return [Person(0.9, place) for place in (places[:1] if close else places)]

    def follow(self, who: int, start: int = 0):
        people = [self.detections(t) for t in range(20)]
        return track(people, Start(start, self.at(who, start), 0.0), self.observe, self.observe, OPTIONS)


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("start", [0, 19])
@pytest.mark.parametrize("who", [0, 1])
@pytest.mark.parametrize("front", [0, 1])
def test_people_who_pass_each_other_are_not_exchanged(who, front, start, back):
    world = Crossing(front, back)
    result = world.follow(who, start)
    for t, seen in enumerate(result.observations):
        if seen is not None:
            assert seen.next_roi == world.at(who, t), t
    absent = [t for t, seen in enumerate(result.observations) if seen is None]
    if who == front:
        assert not absent
    else:
        # Who turns round behind the other is found when the detector sees both.
        assert set(absent) <= set(range(7, 14) if back else range(8, 13))
        assert 10 in absent
        assert all(result.presence[t] == 0 for t in absent)


def test_the_people_near_the_subject_are_reported_also_while_they_are_hidden():
    world = Crossing(front=0)
    result = world.follow(0)
    for t in range(20):
        apart = abs(world.at(0, t).cx - world.at(1, t).cx)
        assert len(result.others[t]) == (apart < 200), t
        for other in result.others[t]:
            assert other.seen == (apart >= 60)
            assert abs(other.roi.cx - world.at(1, t).cx) < 1


def test_somebody_who_is_gone_is_forgotten():
    places = [[Roi(300, 300, 200, 0), Roi(450, 300, 200, 0)] if t < 4 else [Roi(300, 300, 200, 0)] for t in range(12)]

    def observe(t: int, roi: Roi) -> Seen:
        near = [place for place in places[t] if abs(place.cx - roi.cx) < 60]
        return Seen(0.95, near[0]) if near else Seen(0.1, roi)

    people = [[Person(0.9, place) for place in there] for there in places]
    options = dataclasses.replace(OPTIONS, memory=3)
    result = track(people, Start(0, places[0][0], 0.0), observe, observe, options)
    assert [[other.seen for other in others] for others in result.others] == [[True]] * 4 + [[False]] * 3 + [[]] * 5
    assert all(seen is not None for seen in result.observations)
