"""A person who moves before cameras all round and never turns their back to the first of them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from soar.body.motion import BodyMotion
from soar.geometry.cameras import Camera
from soar.raster.types import Pinhole
from soar.synthetic.background import composed
from soar.synthetic.motions import Motion
from soar.synthetic.render import Maps, Posed, visible_points
from soar.synthetic.scene import People, orbit

_TOLERANCE = 0.01  # metres that a point may lie behind the surface that is drawn there and still count as seen


def facing_forward(motion: Motion, times: np.ndarray, turn: float) -> Motion:
    """The same motion on the spot, turned and bent back so that it faces -y on the whole.

    The heading h, from the middle of what it covers at ``times`` (T,) seconds, becomes ``L sin(h / L)``: nearly the
    same where the person turns little, and a swing to and fro within L = ``turn`` degrees where they turn round.
    """
    heading = motion.state(times)[1]
    middle, limit = (heading.min() + heading.max()) / 2, np.radians(turn)

    def state(t: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        angles, heading, place = motion.state(t)
        return angles, limit * np.sin((heading - middle) / limit), np.zeros_like(place)

    return dataclasses.replace(motion, state=state)


def ring(
    points: np.ndarray, azimuths: Mapping[str, float], elevation: float, distance: float, size: tuple[int, int],
    fill: float,
) -> tuple[Camera, ...]:  # fmt: skip
    """Cameras of one lens round a person, all of which hold all of the points.

    Args:
        points: (N, 3) everywhere the person gets to, metres.
        azimuths: camera name -> degrees, see :func:`~soar.synthetic.scene.orbit`.
        elevation: degrees above the horizon.
        distance: of a camera and the middle of the points, metres.
        size: width and height, pixels.
        fill: share of width or height that the points fill in the camera in which they fill most.
    """
    centre, half = (points.min(0) + points.max(0)) / 2, np.array(size) / 2
    poses = {name: orbit(centre, 1, a, elevation, distance, 1).T_cam_from_world for name, a in azimuths.items()}
    focal = np.inf
    for T in poses.values():
        local = points @ T[:3, :3].T + T[:3, 3]
        reach = np.abs(local[:, :2] / local[:, 2:]).max(0)
        focal = min(focal, (fill * half / reach).min())
    focal = np.floor(10 * focal) / 10  # so that the last digits of a sum make no difference
    K = np.array([[focal, 0, half[0]], [0, focal, half[1]], [0, 0, 1]])
    return tuple(Camera(name, *size, K, T, np.zeros(5), "made up") for name, T in poses.items())


class Clip:
    """One person in motion.

    Args:
        people: where the person comes from.
        family, seed: who.
        kind: of motion.
        times: (T,) seconds of the frames.
        turn: degrees the person turns at most from -y, to either side.
    """

    def __init__(self, people: People, family: str, seed: int, kind: str, times: np.ndarray, turn: float) -> None:
        self.people = people
        self.subject = people.subject(family, seed)
        self.light = people.light(self.subject)
        moved = facing_forward(people.motion(self.subject, kind), times, turn)
        self.motion: BodyMotion = moved.body_motion(times, self.subject.betas)
        self._dressed = people.renderer.dress(self.subject)
        self._posed = functools.lru_cache(maxsize=1)(self._pose)

    def _pose(self, t: int) -> Posed:
        pose, translation = self.motion.pose[t].numpy(), self.motion.translation[t].numpy()
        return self.people.renderer.pose(self._dressed, pose, translation, self.light)

    def maps(self, camera: Camera, t: int, back: bool = False) -> tuple[Maps, Maps | None]:
        """Front maps, and back maps if asked for, of frame ``t``."""
        pinhole = Pinhole.from_K(camera.K, camera.width, camera.height)
        return self.people.renderer.draw(self._posed(t), pinhole, camera.T_cam_from_world, back)

    def picture(self, camera: Camera, t: int, background: Tensor) -> np.ndarray:
        """(H, W, 3) uint8 of frame ``t`` before a ``background`` (3, H, W) in [0, 1]."""
        image = composed(self.maps(camera, t)[0], background).clamp(0, 1)
        return torch.round(255 * image).byte().permute(1, 2, 0).numpy()

    def seen(self, camera: Camera, t: int) -> np.ndarray:
        """(V,) bool: vertices of the naked body that a camera sees in frame ``t``."""
        posed, body = self._posed(t), self.people.wardrobe.layer_slices["body"]
        pinhole = Pinhole.from_K(camera.K, camera.width, camera.height)
        return visible_points(
            self.maps(camera, t)[0], pinhole, camera.T_cam_from_world, posed.vertices[body], posed.normals[body],
            _TOLERANCE,
        )  # fmt: skip
