from __future__ import annotations

import dataclasses
from typing import Literal

import pytest

from soar.config import settings
from soar.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class Inner:
    rate: float


@dataclasses.dataclass(frozen=True)
class Outer:
    steps: int
    kind: Literal["a", "b"]
    size: tuple[int, ...]
    box: tuple[float, float] | None
    weights: dict[str, float]
    inner: Inner


GOOD = {"steps": 3, "kind": "a", "size": [1, 2], "box": None, "weights": {"rgb": 1}, "inner": {"rate": 1}}


def test_builds_nested_settings_and_widens_integers() -> None:
    value = settings(Outer, GOOD)
    assert value == Outer(3, "a", (1, 2), None, {"rgb": 1.0}, Inner(1.0))
    assert isinstance(value.inner.rate, float)
    assert isinstance(value.weights["rgb"], float)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": "3"}, "Outer.steps"),
        ({"steps": True}, "Outer.steps"),
        ({"kind": "c"}, "'a', 'b'"),
        ({"size": 3}, "a list"),
        ({"box": [1.0]}, "list of 2"),
        ({"weights": {"rgb": "x"}}, "Outer.weights.rgb"),
        ({"inner": {"rate": 1, "extra": 2}}, "unknown extra"),
        ({"inner": {}}, "missing rate"),
    ],
)
def test_names_what_does_not_fit(change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        settings(Outer, GOOD | change)
