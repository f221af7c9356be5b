"""People by family and seed: the one object that data loaders and datasets need."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from soar.body.record import BodyModel
from soar.geometry.cameras import look_at
from soar.raster.types import Pinhole
from soar.synthetic.light import draw_light
from soar.synthetic.mannequin import Mannequin, Pose, Rig
from soar.synthetic.motions import Motion, draw_motion
from soar.synthetic.poses import draw_pose
from soar.synthetic.records import Light
from soar.synthetic.render import Posed, Renderer
from soar.synthetic.settings import SyntheticSettings
from soar.synthetic.subject import Subject, generator
from soar.synthetic.wardrobe import Helpers, Wardrobe


@dataclasses.dataclass(frozen=True)
class Shot:
    """A camera: intrinsics and (4, 4) ``T_cam_from_world``."""

    pinhole: Pinhole
    T_cam_from_world: np.ndarray


def orbit(
    centre: np.ndarray,
    extent: float,
    azimuth: float,
    elevation: float,
    distance: float,
    size: int,
    shift: tuple[float, float] = (0, 0),
) -> Shot:
    """A square picture that looks at a person.

    Args:
        centre: (3,) world point in the middle, metres.
        extent: metres at the centre's depth that the picture's side shows.
        azimuth: degrees; 0 looks at the front of a person who faces -y, 90 at the left side.
        elevation: degrees above the horizon.
        distance: of camera and centre, metres.
        size: pixels of a side.
        shift: moves the picture's middle by shares of its side, right and down.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    forward = -np.array([math.sin(a) * math.cos(e), -math.cos(a) * math.cos(e), math.sin(e)])
    T = look_at(np.asarray(centre, float), forward, np.array([0.0, 0.0, 1.0]), distance)
    focal = size * distance / extent
    middle = (size / 2 + shift[0] * size, size / 2 + shift[1] * size)
    return Shot(Pinhole(focal, focal, *middle, size, size), T)


class People:
    """An unlimited supply of dressed people.

    Every part of a person has random numbers of its own: ``subject``, ``pose`` and ``light`` of a (family, seed) do not
    change when another part is drawn or left out.

    Args:
        body: the default body.
        helpers: its helper geometry.
        settings: node ``synthetic``.
        threads: of one picture; the pixels do not depend on it.
    """

    def __init__(self, body: BodyModel, helpers: Helpers, settings: SyntheticSettings, threads: int = 1) -> None:
        self.settings = settings
        self.wardrobe = Wardrobe(body, helpers, settings.render.subdivisions)
        self.renderer = Renderer(self.wardrobe, settings.render, threads)
        self._rig = Rig(body)

    def subject(self, family: str, seed: int) -> Subject:
        """Who: shape, skin, hair, clothes."""
        components = self.wardrobe.body.shapedirs.shape[-1]
        return Subject.draw(family, seed, self.wardrobe.anchors, components, self.settings.subject)

    def mannequin(self, subject: Subject) -> Mannequin:
        """The subject's body, to be posed by angles."""
        return Mannequin(self._rig, subject.betas)

    def pose(self, subject: Subject, take: int = 0) -> Pose:
        """A natural pose of this subject; every ``take`` is another."""
        rng = generator(subject.family, subject.seed, f"pose {take}")
        return draw_pose(self.mannequin(subject), rng, self.settings.pose)

    def motion(self, subject: Subject, kind: str, take: int = 0) -> Motion:
        """A short motion of this subject: walk, turn, reach or dance."""
        rng = generator(subject.family, subject.seed, f"{kind} {take}")
        return draw_motion(kind, self.mannequin(subject), rng, self.settings.pose.clearance)

    def light(self, subject: Subject, take: int = 0) -> Light:
        """Soft light from somewhere."""
        return draw_light(generator(subject.family, subject.seed, f"light {take}"), self.settings.light)

    def posed(self, family: str, seed: int, take: int = 0) -> Posed:
        """A person of this family and seed, dressed, posed and lit."""
        subject = self.subject(family, seed)
        pose = self.pose(subject, take)
        return self.renderer.pose(self.renderer.dress(subject), pose.pose, pose.translation, self.light(subject, take))

    def framed(
        self, posed: Posed, azimuth: float, elevation: float, size: int, distance: float = 4.0, fill: float = 0.85
    ) -> Shot:
        """A square view in which the person's larger extent fills ``fill`` of the side."""
        vertices = self.renderer.body_vertices(posed)
        low, high = vertices.min(0), vertices.max(0)
        extent = float(max((high - low)[2], np.linalg.norm((high - low)[:2])))
        return orbit((low + high) / 2, extent / fill, azimuth, elevation, distance, size)
