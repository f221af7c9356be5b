"""Two made-up people who walk past each other, one behind the other: frames, and whose pixels are whose."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.body.record import BodyModel
from soar.config import settings
from soar.raster.types import Pinhole
from soar.synthetic.background import procedural
from soar.synthetic.records import Light
from soar.synthetic.scene import People, Shot, orbit
from soar.synthetic.settings import SyntheticSettings
from soar.synthetic.wardrobe import Helpers
from tests.conftest import conf, model_file


@dataclasses.dataclass(frozen=True)
class Clip:
    """T frames (H, W, 3) uint8 RGB; what is seen of either person, front (0) and back (1): (2, T, H, W) in [0, 1];
    and the pixels they would cover if they were alone, likewise."""

    frames: list[np.ndarray]
    visible: np.ndarray
    whole: np.ndarray


def two_people(seeds: tuple[int, int], count: int, fps: float, size: tuple[int, int]) -> Clip:
    """The person of the first seed walks from left to right, nearer to the camera; the other one to the left."""
    people = People(
        BodyModel.load(model_file("body/anny.npz")), Helpers.load(model_file("body/anny_helpers.npz")),
        settings(SyntheticSettings, conf("synthetic", "default")),
    )  # fmt: skip
    width, height = size
    shot = orbit(np.array([0, 0, -0.05]), 2.7, 0, 3, 4.5, height)
    shot = dataclasses.replace(
        shot, pinhole=Pinhole(shot.pinhole.fx, shot.pinhole.fy, width / 2, height / 2, width, height)
    )
    wall = 0.3 + 0.4 * procedural(height, width, np.random.default_rng(2)).numpy()
    light = people.light(people.subject("benchmark", seeds[0]))
    times = np.arange(count) / fps
    layers = [
        _drawn(people, family, seed, way, depth, times, shot, light)
        for family, seed, way, depth in (("benchmark", seeds[0], 1, -0.5), ("train", seeds[1], -1, 0.5))
    ]
    (near, front), (far, back) = layers
    pictures = near * front[:, None] + (1 - front[:, None]) * (far * back[:, None] + (1 - back[:, None]) * wall)
    frames = [np.round(255 * p.clip(0, 1)).astype(np.uint8).transpose(1, 2, 0).copy() for p in pictures]
    return Clip(frames, np.stack([front, back * (1 - front)]), np.stack([front, back]))


def _drawn(
    people: People, family: str, seed: int, way: int, depth: float, times: np.ndarray, shot: Shot, light: Light
) -> tuple[np.ndarray, np.ndarray]:
    """Colours (T, 3, H, W) and coverage (T, H, W) of one person who passes the middle halfway through."""
    subject = people.subject(family, seed)
    motion = people.motion(subject, "walk")

    def state(t: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        angles, heading, place = motion.state(t)
        return angles, np.full_like(heading, way * np.pi / 2), np.stack([-way * place[:, 1], np.zeros(len(t))], -1)

    pose, translation = dataclasses.replace(motion, state=state).sample(np.append(times, times[len(times) // 2]))
    translation += [-translation[-1, 0], depth, 0]
    dressed = people.renderer.dress(subject)
    maps = [
        people.renderer.draw(people.renderer.pose(dressed, p, t, light), shot.pinhole, shot.T_cam_from_world)[0]
        for p, t in zip(pose[:-1], translation[:-1], strict=True)
    ]
    return np.stack([m.colour.numpy() for m in maps]), np.stack([m.alpha.numpy() for m in maps])
