"""State of a long optimisation on disk, so that a killed run goes on where it was."""

from __future__ import annotations

import time
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from soar.artifacts import atomic_path


class Checkpoint:
    """One file that holds the latest state of one optimisation.

    A state is only ever read back by a run with the same ``key``, a digest of everything that determines the result
    (configuration, inputs, seed); a damaged file or one of another run counts as none.

    Args:
        path: the file.
        key: what the state belongs to.
        seconds: least time between two saves.
    """

    def __init__(self, path: Path, key: str, seconds: float) -> None:
        self.path, self.key, self.seconds = path, key, seconds
        self._saved = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The latest state of this very run, or None."""
        if not self.path.exists():
            return None
        try:
            stored = torch.load(self.path, map_location="cpu", weights_only=True)
        except (OSError, RuntimeError, EOFError, UnpicklingError):
            return None
        return stored["state"] if isinstance(stored, dict) and stored.get("key") == self.key else None

    def save(self, state: dict[str, Any]) -> None:
        """Write the state atomically; the previous one survives a kill in between."""
        with atomic_path(self.path) as temporary:
            torch.save({"key": self.key, "state": state}, temporary)
        self._saved = time.monotonic()

    def due(self) -> bool:
        """Whether the last save is long enough ago."""
        return time.monotonic() - self._saved >= self.seconds
