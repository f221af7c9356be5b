"""Shared fixtures: settings from conf/, the reference seed, and marks for tests that need fetched models or data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent


def conf(group: str, option: str) -> dict[str, Any]:
    """The plain content of ``conf/<group>/<option>.yaml``."""
    return yaml.safe_load((ROOT / "conf" / group / f"{option}.yaml").read_text(encoding="utf-8"))


def model_file(name: str) -> Path:
    """Path of a fetched model, or skip the test with the command that fetches it."""
    path = ROOT / "data" / "models" / name
    if not path.exists():
        pytest.skip(f"data/models/{name} is not there; `make demo` or `python -m soar models fetch` brings it")
    return path
