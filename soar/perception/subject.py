"""Which of the detected people is the subject, and from which frame to follow them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from soar.errors import SubjectError
from soar.perception.detector import POSE_SCALE, Person
from soar.perception.keypoints import Choice
from soar.perception.roi import Roi

CHOOSE = "choose the person with dataset.subject.point=[x,y] or dataset.subject.box=[x0,y0,x1,y1]"


class Undecided(SubjectError):
    """Who the subject is, is in doubt; a picture of the people in one frame lets the user decide.

    Args:
        what, expected, got, cure: see :class:`~soar.errors.SoarError`.
        frame: index of the frame.
        people: regions of those in question.
    """

    def __init__(self, what: str, *, expected: str, got: str, cure: str, frame: int, people: Sequence[Roi]) -> None:
        super().__init__(what, expected=expected, got=got, cure=cure)
        self.frame, self.people = frame, tuple(people)


@dataclasses.dataclass(frozen=True)
class SubjectSettings:
    """How the subject is chosen when several people are in view. All shares in [0, 1]."""

    same_person_overlap: float
    start_prominence: float
    rival_remark: float
    rival_error: float
    rival_frames: float


@dataclasses.dataclass(frozen=True)
class Start:
    """Where tracking starts.

    Attributes:
        frame: index of the frame.
        roi: the subject's region there.
        rivalry: median over the frames of the second most prominent person's share of the most prominent one's
            prominence; 0 if nobody else was seen or if the user chose.
    """

    frame: int
    roi: Roi
    rivalry: float


def prominence(person: Person, width: int, height: int) -> float:
    """How much a person looks like the subject of the shot: score x share of the frame's height x centrality.

    Centrality falls from 1 at the centre of the image to 1/2 at its corners.
    """
    away = math.hypot(person.roi.cx - width / 2, person.roi.cy - height / 2) / math.hypot(width / 2, height / 2)
    return person.score * person.roi.side / max(width, height) * (1 - min(away, 1.0) / 2)


def distinct(people: Sequence[Person], max_overlap: float) -> list[Person]:
    """Drop detections whose region overlaps a better-scored one's by more than ``max_overlap`` (same body twice)."""
    kept: list[Person] = []
    for person in sorted(people, key=lambda p: -p.score):
        if all(person.roi.overlap(k.roi) <= max_overlap for k in kept):
            kept.append(person)
    return kept


def most_prominent(detections: Sequence[Sequence[Person]], width: int, height: int, settings: SubjectSettings) -> Start:
    """Take the most prominent person, in the frame in which they are detected with the best score.

    Args:
        detections: people of every frame, (T,) lists.
        width, height: of the frames, pixels.
        settings: when several people count as equally likely.

    Raises:
        SubjectError: nobody was found in any frame.
        Undecided: in most frames a second person is nearly as prominent.
    """
    ranked = [
        sorted(
            ((prominence(p, width, height), p) for p in distinct(people, settings.same_person_overlap)),
            key=lambda r: -r[0],
        )
        for people in detections
    ]
    seen = [(frame, people) for frame, people in enumerate(ranked) if people]
    if not seen:
        raise SubjectError(
            "no person was found in any frame",
            expected="one person, mostly in view",
            got=f"{len(detections)} frames without a detection",
            cure="check that the video shows a person at least a tenth of the frame high, and that it is not rotated",
        )
    ratios = sorted(people[1][0] / people[0][0] if len(people) > 1 else 0.0 for _, people in seen)
    rivals = sum(r >= settings.rival_error for r in ratios)
    # A detection that mixes two people is large but scores low, so size only decides which people come into question.
    prominent = [s for s in seen if s[1][0][0] >= settings.start_prominence * max(p[0][0] for _, p in seen)]
    frame, people = max(prominent, key=lambda s: s[1][0][1].score)
    if rivals > settings.rival_frames * len(seen):
        # The message shows a frame with the rival in it, so that the user can copy a point.
        frame, people = next((f, p) for f, p in seen if len(p) > 1 and p[1][0] / p[0][0] >= settings.rival_error)
        points = ", ".join(f"[{p.roi.cx:.0f},{p.roi.cy:.0f}]" for _, p in people[:4])
        raise Undecided(
            "several people are equally likely to be the subject",
            expected="one person clearly larger or more central than the others",
            got=f"in {rivals} of {len(seen)} frames a second person is {settings.rival_error:.0%} as prominent;"
            f" frame {frame} shows people at {points}",
            cure=CHOOSE,
            frame=frame,
            people=[p.roi for _, p in people],
        )
    return Start(frame, people[0][1].roi, ratios[len(ratios) // 2])


def chosen(detections: Sequence[Sequence[Person]], choice: Choice) -> Start:
    """Take the person at the user's point or box.

    A point takes the person whose region contains it with the nearest centre. A box takes the detection that overlaps
    it most; where the detector saw nobody, the box itself is the region.

    Raises:
        SubjectError: the frame does not exist.
        Undecided: nobody was detected at the point.
    """
    if not 0 <= choice.frame < len(detections):
        raise SubjectError(
            f"the subject was chosen in frame {choice.frame}, which does not exist",
            expected=f"0 to {len(detections) - 1}",
            got=str(choice.frame),
            cure="correct dataset.subject.frame",
        )
    people = detections[choice.frame]
    if choice.box is not None:
        x0, y0, x1, y1 = choice.box
        around = Roi((x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0) * POSE_SCALE, 0.0)
        best = max((p.roi for p in people), key=around.overlap, default=around)
        return Start(choice.frame, best if best.overlap(around) > 0.2 else around, 0.0)
    if choice.point is None:
        raise ValueError("a choice needs a point or a box")
    x, y = choice.point
    hit = [p.roi for p in people if p.roi.contains(x, y)]
    if not hit:
        found = ", ".join(f"[{p.roi.cx:.0f},{p.roi.cy:.0f}]" for p in people) or "nobody"
        raise Undecided(
            f"nobody was found at point [{x:g},{y:g}] of frame {choice.frame}",
            expected="a point on a person the detector sees",
            got=f"people at {found}",
            cure="choose another point or frame, or give dataset.subject.box=[x0,y0,x1,y1]",
            frame=choice.frame,
            people=[p.roi for p in people],
        )
    return Start(choice.frame, min(hit, key=lambda r: math.hypot(r.cx - x, r.cy - y) / r.side), 0.0)
