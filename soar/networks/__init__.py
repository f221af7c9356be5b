"""The networks that this project trains itself (docs/networks.md)."""

from importlib.resources import files
from pathlib import Path

DATA = Path(str(files("soar.networks") / "data"))
"""Folder of the trained ones, with their records."""
