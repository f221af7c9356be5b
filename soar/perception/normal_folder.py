"""A folder of normal maps: which file shows which side of which frame, and which part of it."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from soar.artifacts import read_json
from soar.errors import ArtifactError, InputError
from soar.perception.normal_maps import Box
from soar.perception.normal_pictures import SUFFIXES, arrays_in, read_map

SIDES = {"front": ("front", "normal_f", "nml_f", "f"), "back": ("back", "normal_b", "nml_b", "b")}
"""What a folder, the end of a file's name, or an array in a file is called by the side it shows, lower case; what is
called nothing of the kind shows the front."""

WINDOWS = "windows.json"
"""File that says which part of its frame each map shows."""

CURE = "see docs/normals.md for the layout; `python -m soar models check FOLDER` tells what a folder holds"


@dataclasses.dataclass(frozen=True)
class NormalFolder:
    """Maps by side and by the number in their names.

    Attributes:
        path: of the folder.
        sides: ``front``, and ``back`` where there are any -> number -> file.
        windows: number -> part of the frame that a map shows, in shares of width and height; None: all of it.
    """

    path: Path
    sides: Mapping[str, Mapping[int, Path]]
    windows: Mapping[int, Box] | None

    def describe(self) -> str:
        """What there is, in words; raises as :meth:`read` does."""
        height, width = self.read("front", min(self.sides["front"])).shape[:2]
        counts = ", ".join(f"{len(numbers)} {side} maps" for side, numbers in self.sides.items())
        return f"{counts} of {width} x {height} pixels, of {'windows' if self.windows else 'whole frames'}"

    def read(self, side: str, number: int) -> np.ndarray:
        """A map, see :func:`soar.perception.normal_pictures.read_map`."""
        path = self.sides[side][number]
        names = arrays_in(path)
        return read_map(path, next((name for name in names if name.lower() in SIDES[side]), next(iter(names), None)))


def find(folder: Path) -> NormalFolder:
    """The maps in a folder and below.

    Raises:
        InputError: there are none, two of one side and frame, one without a number, or a malformed ``windows.json``.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder", expected="a folder of normal maps", cure=CURE)
    sides: dict[str, dict[int, Path]] = {}
    for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES):
        stem, shown = _stem_and_sides(path, folder)
        numbers = re.findall(r"\d+", stem)
        if not numbers or len(numbers[-1]) > 12:
            raise InputError(f"{path}: no frame's number in the name", expected="000012.png or the like", cure=CURE)
        for side in shown:
            other = sides.setdefault(side, {}).setdefault(int(numbers[-1]), path)
            if other != path:
                got = f"{other.relative_to(folder)}, {path.relative_to(folder)}"
                raise InputError(f"{folder}: two {side} maps of frame {int(numbers[-1])}", got=got, cure=CURE)
    if "front" not in sides:
        raise InputError(
            f"{folder} holds no front maps", expected=f"files {', '.join(SUFFIXES)} by frame",
            got=f"{len(sides.get('back', ()))} back maps", cure=CURE,
        )  # fmt: skip
    windows = folder / WINDOWS
    ordered = {side: sides[side] for side in SIDES if side in sides}
    return NormalFolder(folder, ordered, _windows(windows) if windows.is_file() else None)


def _stem_and_sides(path: Path, folder: Path) -> tuple[str, list[str]]:
    """A file's name without what tells the side, and the sides it shows."""
    stem, side = _split(path.stem)
    if side:
        return stem, [side]
    for part in path.relative_to(folder).parts[:-1]:
        rest, side = _split(part)
        if side and not rest:
            return stem, [side]
    names = {name.lower() for name in arrays_in(path)}
    return stem, [side for side in SIDES if names.intersection(SIDES[side])] or ["front"]


def _split(text: str) -> tuple[str, str | None]:
    """A name without its ending, and the side that the ending stands for."""
    words = re.split(r"[_.-]", text.lower())
    for count in (2, 1):
        for side, names in SIDES.items():
            if "_".join(words[-count:]) in names:
                return "_".join(words[:-count]), side
    return text, None


def _windows(path: Path) -> dict[int, Box]:
    """``windows.json``: ``{"size": [width, height], "windows": {"000012": [x0, y0, x1, y1]}}`` in pixels."""
    try:
        content = read_json(path)
        width, height = (float(side) for side in content["size"])
        boxes = {int(name): np.array(box, np.float64) for name, box in content["windows"].items()}
        good = all(b.shape == (4,) and np.isfinite(b).all() and (b[:2] < b[2:]).all() for b in boxes.values())
        if not (0 < width < np.inf and 0 < height < np.inf and good):
            raise ValueError("sizes must be positive, and x0 < x1, y0 < y1")
    except (ArtifactError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        reason = error.what if isinstance(error, ArtifactError) else error
        expected = '{"size": [width, height], "windows": {"000012": [x0, y0, x1, y1], ...}}'
        raise InputError(f"{path} is malformed: {reason}", expected=expected, cure=CURE) from error
    scale = np.array([width, height, width, height])
    return {name: tuple((box / scale).tolist()) for name, box in boxes.items()}
