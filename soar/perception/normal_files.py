"""Normal maps that another program made, one file per frame (docs/normals.md)."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from typing import Literal

import numpy as np

from soar.errors import ConfigError, InputError
from soar.perception.body_normals import FRONT_ONLY, behind
from soar.perception.brought import brought_file
from soar.perception.normal_folder import CURE, WINDOWS, find
from soar.perception.normal_maps import Context, Crop, Signs, sampled, seen_from, settled

CONVENTIONS: dict[str, tuple[int, int, int]] = {
    "opencv": (1, 1, 1),
    "metric3d": (1, 1, 1),
    "moge": (1, 1, 1),
    "icon": (1, -1, -1),
    "econ": (1, -1, -1),
    "sapiens": (1, -1, -1),
    "marigold": (1, -1, -1),
    "dsine": (-1, -1, -1),
    "stablenormal": (-1, -1, -1),
    "nyu": (1, 1, -1),
}
"""Signs of x, y, z that turn the normals of a program into this project's."""

_TURNED = (-1, 1, -1)  # half a turn about the vertical: the axes of a camera behind


@dataclasses.dataclass(frozen=True)
class NormalFileSettings:
    """Node ``normals`` with the provider ``files``.

    Attributes:
        provider: ``files``.
        source: folder of the maps of a camera.
        convention: a name of :data:`CONVENTIONS`, or ``auto``: the one whose signs are those of a closed surface.
        first_number: number in the file names of the recording's first frame.
        threshold: mask value in [0, 1] from which a pixel gets normals.
        tried: maps that tell the convention and the frame of the back maps.
        agreement: share of those maps that must tell the same.
    """

    provider: Literal["files"]
    source: str
    convention: str
    first_number: int
    threshold: float
    tried: int
    agreement: float

    def __post_init__(self) -> None:
        if self.convention != "auto" and self.convention not in CONVENTIONS:
            known = ", ".join(("auto", *CONVENTIONS))
            raise ConfigError("unknown normals.convention", expected=known, got=repr(self.convention))
        if self.tried < 1 or not 0.5 < self.agreement <= 1:
            got = f"tried {self.tried}, agreement {self.agreement}"
            raise ConfigError("normals.tried, normals.agreement", expected="1 or more, (0.5, 1]", got=got)


class NormalFiles:
    """The provider ``files``: maps of whole frames or of windows, of the front or of both sides.

    Raises:
        ConfigError: no folder is named.
        InputError: files are missing or cannot be used, or do not tell their convention.
    """

    def __init__(self, options: NormalFileSettings, context: Context) -> None:
        self.options, self.backend = options, context.backend
        self.folder = find(brought_file(context.brought, "source", "normals"))
        self.remarks: list[str] = []
        self._check_complete(context.frames)
        tried = np.unique(np.linspace(0, len(context.crops) - 1, options.tried).round().astype(int))
        crops = [context.crops[i] for i in tried]
        self.axes = {"front": self._front_axes(crops)}
        self.mirrored = False
        if "back" in self.folder.sides:
            self.axes["back"], self.mirrored = self._back_axes(crops)
        else:
            self.remarks.append(FRONT_ONLY)

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; zero outside the mask."""
        front = self._map(crop, "front") * self.axes["front"]
        if "back" not in self.axes:
            return front, behind(crop, self._inside(crop), self.backend)
        return front, self._map(crop, "back", self.mirrored) * self.axes["back"]

    def _check_complete(self, frames: Iterable[int]) -> None:
        wanted = {frame + self.options.first_number: frame for frame in frames}
        for what, numbers in (*self.folder.sides.items(), (WINDOWS, self.folder.windows)):
            missing = [] if numbers is None else [number for number in wanted if number not in numbers]
            if missing:
                raise InputError(
                    f"{self.folder.path}: no {what} for {len(missing)} of {len(wanted)} frames",
                    expected=f"{missing[0]:06d}, which is frame {wanted[missing[0]]} of the recording",
                    got=f"numbers {min(numbers)} to {max(numbers)}" if numbers else "nothing",
                    cure="name files by the frame's number in the recording, whose first is normals.first_number",
                )

    def _front_axes(self, crops: list[Crop]) -> np.ndarray:
        if self.options.convention != "auto":
            return np.array(CONVENTIONS[self.options.convention], np.float32)
        maps = [self._map(crop, "front") for crop in crops]
        votes = Counter(
            axes
            for found in maps
            for axes in dict.fromkeys(CONVENTIONS.values())
            if Signs.of(found * np.array(axes, np.float32)).front
        )
        axes, count = votes.most_common(1)[0] if votes else ((1, 1, 1), 0)
        if count < self.options.agreement * len(maps):
            signs = Signs.of(maps[0])
            raise InputError(
                f"{self.folder.path}: the maps do not tell their convention",
                expected=f"the signs of one of {', '.join(CONVENTIONS)} in {self.options.agreement:.0%} of the maps",
                got=f"{count} of {len(maps)}; in the first n_z is {signs.facing:.2f} amid, n_x {signs.left:.2f} "
                f"left and {signs.right:.2f} right, n_y {signs.top:.2f} above and {signs.bottom:.2f} below",
                cure="set normals.convention to the program that made them",
            )
        names = ", ".join(name for name, signs in CONVENTIONS.items() if signs == axes)
        self.remarks.append(
            f"The normal maps are in the convention of {names}: so say the signs of {count} of {len(maps)} maps."
        )
        return np.array(axes, np.float32)

    def _back_axes(self, crops: list[Crop]) -> tuple[np.ndarray, bool]:
        """Signs of the back maps, and whether their pixels are mirrored: they may be seen by a camera behind."""
        votes: Counter[tuple[tuple[int, ...], bool]] = Counter()
        for crop in crops:
            overlap = {}
            for mirrored in (False, True):
                found = self._map(crop, "back", mirrored)
                share = float((np.abs(found).max(-1) > 0).sum() / max(self._inside(crop).sum(), 1))
                for turn in ((1, 1, 1), _TURNED):
                    if Signs.of(found * self.axes["front"] * np.array(turn, np.float32)).back:
                        overlap[turn, mirrored] = share
            if overlap:
                votes[max(overlap, key=lambda way: overlap[way])] += 1
        (turn, mirrored), count = votes.most_common(1)[0] if votes else (((1, 1, 1), False), 0)
        if count < self.options.agreement * len(crops):
            raise InputError(
                f"{self.folder.path}: the back maps are in no known frame",
                expected="normals in the frame of the front map, pixel by pixel on it, or as a camera behind sees them",
                got=f"the signs of either in {count} of {len(crops)} maps",
                cure="leave the back maps out: the body model's stand in; or export them again (docs/normals.md)",
            )
        if turn == _TURNED or mirrored:
            ways = (("turned", turn == _TURNED), ("mirrored", mirrored))
            done = " and ".join(word for word, true in ways if true)
            self.remarks.append(
                f"The back maps are those of a camera behind; they are {done} to lie on the front maps."
            )
        return self.axes["front"] * np.array(turn, np.float32), mirrored

    def _inside(self, crop: Crop) -> np.ndarray:
        return crop.alpha >= 255 * self.options.threshold

    def _map(self, crop: Crop, side: str, mirrored: bool = False) -> np.ndarray:
        """The map of a crop (H, W, 3) float32 in its own axes, zero outside the mask."""
        number = crop.frame + self.options.first_number
        normals = self.folder.read(side, number)
        height, width = normals.shape[:2]
        wide, tall = crop.size
        window = (0.0, 0.0, 1.0, 1.0)
        if self.folder.windows is not None:
            window = self.folder.windows[number]
        elif abs(width * tall - height * wide) > 0.01 * height * wide:
            raise InputError(
                f"{self.folder.sides[side][number]} is no map of the whole frame",
                expected=f"the aspect of {wide} x {tall}, or a {WINDOWS} in {self.folder.path}",
                got=f"{width} x {height}", cure=CURE,
            )  # fmt: skip
        shown = (window[0] * wide, window[1] * tall, window[2] * wide, window[3] * tall)
        inside = self._inside(crop)
        place = seen_from(crop.box, shown, width, height)
        aligned = np.ascontiguousarray(normals[:, ::-1]) if mirrored else normals
        found = sampled(aligned, place, inside.shape[1], inside.shape[0])
        # A pixel that is not at least half covered has no normal.
        return settled(found, inside & (np.linalg.norm(found, axis=-1) > 0.5))
