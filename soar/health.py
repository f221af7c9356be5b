"""Health numbers: what a stage measured of its own result, judged later by the report's limits."""

from __future__ import annotations

import dataclasses
import math
import os
from typing import Any

from soar.artifacts import read_json, write_json


@dataclasses.dataclass
class Health:
    """Named numbers with units, and plain-language remarks, of one stage.

    A number's full name is ``stage.name`` (cameras appended by the stage as ``name/camera``); the limits it is
    judged by stand in ``conf/report``.
    """

    stage: str
    numbers: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    remarks: list[str] = dataclasses.field(default_factory=list)

    def add(self, name: str, value: float, unit: str = "") -> None:
        """Record one number; a NaN or infinity is kept as null, and shown as missing."""
        value = float(value)
        self.numbers[name] = {"value": value if math.isfinite(value) else None, "unit": unit}

    def remark(self, text: str) -> None:
        """Record a sentence the user should read."""
        self.remarks.append(text)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write ``health.json``."""
        write_json(path, dataclasses.asdict(self))

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Health:
        """Read ``health.json``."""
        return Health(**read_json(path))
