"""Named errors: what they print, and that each says what to do."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from soar import errors
from soar.errors import CalibrationError, ConfigError, InputError, SoarError
from tests.conftest import ROOT

# Where what a user gives enters; kernels and optimisers below are called by us alone.
ENTRANCES = ("datasets", "models", "perception", "losses")
FILES = sorted([*(ROOT / "soar").glob("*.py"), *(p for name in ENTRANCES for p in (ROOT / "soar" / name).glob("*.py"))])
CLASSES = {name: value for name, value in vars(errors).items() if isinstance(value, type)}


def test_the_parts_are_printed_in_order() -> None:
    error = InputError("clip.mp4 is short", expected="8 frames", got="3", cure="film longer")
    assert str(error).splitlines() == [
        "clip.mp4 is short",
        "  expected: 8 frames",
        "  got:      3",
        "  to do:    film longer",
    ]
    assert str(InputError("alone")) == "alone"
    assert {cls.exit_code for cls in CLASSES.values()} == {2}


def test_the_class_says_what_to_do_where_the_error_does_not() -> None:
    assert ConfigError("a").cure == ConfigError.default_cure
    assert ConfigError("a", cure="b").cure == "b"
    assert "docs/data.md" in str(CalibrationError("a"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT / "soar")))
def test_every_error_says_what_to_do(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CLASSES:
            cls = CLASSES[node.func.id]
            assert issubclass(cls, SoarError)
            assert cls.default_cure or "cure" in {keyword.arg for keyword in node.keywords}, f"line {node.lineno}"
