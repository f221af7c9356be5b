"""Health numbers against limits: what should be looked at first."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Literal

from soar.errors import ConfigError

Grade = Literal["bad", "missing", "warn", "ok", "free"]
ORDER: tuple[Grade, ...] = ("bad", "missing", "warn", "ok", "free")


@dataclasses.dataclass(frozen=True)
class Limit:
    """A number at or beyond ``good`` is fine, one beyond ``bad`` is not; the larger of the two tells the direction."""

    good: float
    bad: float

    def __post_init__(self) -> None:
        if self.good == self.bad:
            raise ConfigError("a limit's good and bad must differ", got=str(self.good), cure="correct report.limits")

    def severity(self, value: float) -> float:
        """0 at ``good``, 1 at ``bad``, linear beyond both."""
        return (self.good - value) / (self.good - self.bad)

    def grade(self, value: float | None) -> Grade:
        """Grade of a value; None is missing."""
        if value is None:
            return "missing"
        severity = self.severity(value)
        return "ok" if severity <= 0 else "warn" if severity <= 1 else "bad"


@dataclasses.dataclass(frozen=True)
class Number:
    """A health number, judged.

    Attributes:
        place: which sequence, variant and camera it belongs to, in words.
        name: ``stage.name`` without the camera.
        value: None where it could not be measured.
        unit: may be empty.
        limit: None where no limit is configured; the grade is then ``free``.
        anchor: id of the stage's section on the page.
    """

    place: str
    name: str
    value: float | None
    unit: str
    limit: Limit | None
    anchor: str

    @property
    def grade(self) -> Grade:
        """How the number is judged."""
        return "free" if self.limit is None else self.limit.grade(self.value)


def limit_of(name: str, limits: Mapping[str, Limit]) -> Limit | None:
    """The limit of the number ``stage.name/camera``: its own, or that of ``stage.name``."""
    return limits.get(name) or limits.get(name.split("/")[0])


def worst_first(numbers: Iterable[Number]) -> list[Number]:
    """The judged numbers: bad, missing, warn, ok; within a grade the farther from good the earlier."""
    judged = [number for number in numbers if number.limit is not None]

    def key(number: Number) -> tuple[int, float, str]:
        known = number.limit is not None and number.value is not None
        return ORDER.index(number.grade), -number.limit.severity(number.value) if known else 0.0, number.name

    return sorted(judged, key=key)
