"""A user's own clips: one camera each, intrinsics given or assumed."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from soar.datasets.recordings import recording
from soar.datasets.selection import FrameSettings, SubjectSettings
from soar.errors import ConfigError, InputError

if TYPE_CHECKING:
    from soar.datasets.capture import Capture

CAMERA = "camera"


@dataclasses.dataclass(frozen=True)
class IntrinsicsSettings:
    """The lens of a clip, in pixels of the recording as a player shows it.

    Attributes:
        K: ``[fx, fy, cx, cy]`` or three rows; the centre of the top-left pixel is (0.5, 0.5). None assumes a lens.
        distortion: OpenCV k1 k2 p1 p2 [k3]; None is none.
        assumed_fov_deg: field of view along the long side that is assumed without K, degrees.
    """

    K: tuple[float, ...] | tuple[tuple[float, ...], ...] | None
    distortion: tuple[float, ...] | None
    assumed_fov_deg: float


@dataclasses.dataclass(frozen=True)
class VideoSettings:
    """Configuration of clips of one's own.

    Attributes:
        name: name of the dataset, the folder below ``results/``.
        adapter: ``video``.
        path: a video or a folder of images, or several; each is one sequence.
        intrinsics, frames, subject: see there.
    """

    name: str
    adapter: str
    path: str | tuple[str, ...] | None
    intrinsics: IntrinsicsSettings
    frames: FrameSettings
    subject: SubjectSettings


class Video:
    """Single-camera clips; the world is the camera's own frame, up is the top of the image."""

    packaged = None
    provides: frozenset[str] = frozenset()

    def __init__(self, settings: VideoSettings) -> None:
        self.settings = settings
        self._paths = sequence_names(settings.path)

    def sequences(self) -> list[str]:
        return list(self._paths)

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        return [] if which == "eval" else [CAMERA]

    def sources(self, sequence: str) -> list[Path]:
        return recording(self._paths[sequence]).files()

    def downloads(self) -> list[Path]:
        return []

    def capture(self, sequence: str) -> Capture:
        import numpy as np

        from soar.datasets.calibration import distortion_vector, intrinsic_matrix
        from soar.datasets.capture import Capture
        from soar.geometry.cameras import Camera

        clip, lens = recording(self._paths[sequence]), self.settings.intrinsics
        width, height = clip.probe.width, clip.probe.height
        remarks: tuple[str, ...] = ()
        if lens.K is not None:
            K, origin = intrinsic_matrix(lens.K, "dataset.intrinsics"), "configuration (dataset.intrinsics.K)"
            if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
                point = f"({K[0, 2]:.0f}, {K[1, 2]:.0f})"
                remarks = (f"The principal point {point} is outside the {width}x{height} frame: check K.",)
        else:
            if not 1 < lens.assumed_fov_deg < 170:
                raise ConfigError(
                    "dataset.intrinsics.assumed_fov_deg", expected="1 to 170", got=str(lens.assumed_fov_deg)
                )
            focal = max(width, height) / 2 / math.tan(math.radians(lens.assumed_fov_deg) / 2)
            K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
            origin = f"assumed field of view of {lens.assumed_fov_deg:g} degrees along the long side"
            remarks = (f"The intrinsics are an {origin}; depth depends on it. Set dataset.intrinsics.K if known.",)
        distortion = distortion_vector(lens.distortion or (0, 0, 0, 0), "dataset.intrinsics")
        return Capture(
            name=sequence,
            cameras=(Camera(CAMERA, width, height, K, np.eye(4), distortion, origin),),
            recordings={CAMERA: clip},
            train=(CAMERA,),
            eval=(),
            up=np.array([0.0, -1.0, 0.0]),
            fps=None,
            frames=self.settings.frames,
            subject=self.settings.subject,
            remarks=remarks,
        )


def sequence_names(path: str | tuple[str, ...] | None) -> dict[str, Path]:
    """Sequence name -> path for ``dataset.path``; a name is the file's stem with unusual characters made ``_``.

    Raises:
        ConfigError: no path is given.
        InputError: a path does not exist, or two paths make the same name.
    """
    paths = (path,) if isinstance(path, str) else path
    if not paths:
        raise ConfigError(
            "dataset.path is not set", expected="a path, or a list of paths", cure='add "dataset={path: ...}"'
        )
    names: dict[str, Path] = {}
    for entry in map(Path, paths):
        if not entry.exists():
            raise InputError(f"{entry} does not exist", cure="correct dataset.path")
        stem = entry.resolve().name if entry.is_dir() else entry.stem
        name = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_") or "sequence"
        if name in names:
            raise InputError(f"{names[name]} and {entry} both make the sequence {name!r}", cure="rename one of them")
        names[name] = entry
    return names
