"""Grades and their order."""

from __future__ import annotations

import pytest

from soar.errors import ConfigError
from soar.report.judge import Limit, Number, limit_of, worst_first


@pytest.mark.parametrize(
    ("good", "bad", "value", "grade"),
    [
        (0.9, 0.8, 0.95, "ok"),
        (0.9, 0.8, 0.9, "ok"),
        (0.9, 0.8, 0.85, "warn"),
        (0.9, 0.8, 0.8, "warn"),
        (0.9, 0.8, 0.79, "bad"),
        (0.9, 0.8, None, "missing"),
        (5.0, 10.0, 4.0, "ok"),
        (5.0, 10.0, 7.0, "warn"),
        (5.0, 10.0, 11.0, "bad"),
        (0.0, 0.1, 0.0, "ok"),
    ],
)
def test_grades(good: float, bad: float, value: float | None, grade: str) -> None:
    assert Limit(good, bad).grade(value) == grade


def test_equal_limits_have_no_direction() -> None:
    with pytest.raises(ConfigError, match="differ"):
        Limit(1.0, 1.0)


def test_a_camera_may_have_its_own_limit() -> None:
    limits = {"body.iou": Limit(0.9, 0.8), "body.iou/cam03": Limit(0.7, 0.6)}
    assert limit_of("body.iou/cam03", limits) == Limit(0.7, 0.6)
    assert limit_of("body.iou/cam01", limits) == Limit(0.9, 0.8)
    assert limit_of("body.jitter", limits) is None


def test_worst_first_across_units_and_directions() -> None:
    def number(name: str, value: float | None, limit: Limit | None) -> Number:
        return Number("s / full", name, value, "", limit, "a")

    numbers = [
        number("fine", 1.0, Limit(0.9, 0.8)),
        number("awful", 100.0, Limit(5, 10)),
        number("free", 3.0, None),
        number("absent", None, Limit(0.9, 0.8)),
        number("bad", 0.79, Limit(0.9, 0.8)),
        number("warned", 9.0, Limit(5, 10)),
        number("hardly warned", 0.89, Limit(0.9, 0.8)),
    ]
    assert [n.name for n in worst_first(numbers)] == ["awful", "bad", "absent", "warned", "hardly warned", "fine"]
