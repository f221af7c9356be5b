"""Following a subject with a stand-in estimator whose person moves on a known path."""

from __future__ import annotations

import dataclasses

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
    return track(people, Start(start, world.at(start), 0.0), world.observe, OPTIONS)


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


def test_nearest_ignores_people_far_away_or_of_another_size():
    last = Roi(500, 500, 200, 0)
    near, far, tiny = (Person(0.9, Roi(x, 500, s, 0)) for x, s in ((560, 210), (900, 200), (510, 60)))
    assert nearest([far, tiny, near], last, 0.75) == near.roi
    assert nearest([far, tiny], last, 0.75) is None
    assert nearest([], last, 0.75) is None
