"""Turn the finished avatar round once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import write_image
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.geometry.rotations import axis_angle_to_matrix
from soar.health import Health
from soar.progress import track
from soar.raster import Pinhole
from soar.report.footage import RenderSettings, TurntableSettings, crack_share, panels
from soar.report.orbit import Orbit
from soar.report.pictures import grid
from soar.report.shots import Shot
from soar.report.video import write_video
from soar.stages import Job
from soar.stages._rig import Rig

_SHOWN = 8  # angles on the evidence strip


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the turntable (colour, normals, occlusion), a strip of eight angles, and health."""
    options = settings(RenderSettings, cfg["render"], "render").turntable
    rig, up = _stand(Rig.read(inputs, cfg), Sequence.read(inputs["sequence"]).up, options)
    puppet = rig.puppet(Avatar.read(inputs["avatar"]))
    front = axis_angle_to_matrix(rig.motion.pose[0, 0]) @ rig.body.front
    points, _ = puppet.pose(0, torch.eye(4))
    fov = np.deg2rad(options.fov)
    orbit = Orbit.around(points.numpy(), up, front.numpy(), options.height, fov, options.margin)
    turn = _turn(puppet, orbit, options.frames)
    pictures = (_panels(shot) for shot in track(turn, "turntable", options.frames))
    count = write_video(outputs["turntable"], pictures, options.fps)
    strip = list(_turn(puppet, orbit, _SHOWN))
    rows = [[shot.on_white(), shot.normals_on_white(), shot.occlusion_on_white()] for shot in strip]
    write_image(outputs["evidence"], grid([row[kind] for kind in range(3) for row in rows], _SHOWN))
    health = Health("render")
    health.add("frames", count)
    health.add("crack_share", float(np.mean([crack_share(shot) for shot in strip])))
    health.write(outputs["health"])


def _stand(rig: Rig, up: np.ndarray, options: TurntableSettings) -> tuple[Rig, np.ndarray]:
    """A rig that stands still in one frame, and its up axis; ``up`` is the scene's."""
    t = round(options.frame * (len(rig.motion) - 1))
    pose, translation = rig.motion.pose[t : t + 1], rig.motion.translation[t : t + 1]
    if options.pose == "canonical":
        pose, translation, up = rig.body.canonical_pose[None], torch.zeros(1, 3), rig.body.up.double().numpy()
    still = dataclasses.replace(rig.motion, pose=pose, translation=translation)
    return dataclasses.replace(rig, motion=still), up


def _turn(puppet: Puppet, orbit: Orbit, count: int) -> Iterator[Shot]:
    """``count`` looks at even angles, front first."""
    pinhole = Pinhole.from_K(orbit.K, orbit.width, orbit.height)
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        T = torch.from_numpy(orbit.T_cam_from_world(float(angle))).float()
        yield Shot.of(puppet.render(0, T, pinhole))


def _panels(shot: Shot) -> np.ndarray:
    return panels(shot.on_white(), shot.normals_on_white(), shot.occlusion_on_white())
