"""A sequence of two cameras round the capsule of :mod:`tests.avatar.toy`, with files as the stages leave them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch

from soar.artifacts import write_npz, write_tensors
from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar, from_body
from soar.datasets.sequence import Sequence, Source, Subject
from soar.geometry.cameras import Camera
from soar.report.pictures import composite, to_uint8
from soar.report.shots import Shot
from tests.avatar import toy
from tests.conftest import conf

FRAMES = 4
AZIMUTH = {"front": 0.0, "back": np.pi}


def avatar() -> Avatar:
    """A colourful capsule whose rear half was never seen."""
    dense = dataclasses.replace(toy.avatar_settings(), subdivisions=2)
    surfels = from_body(toy.body(), toy.motion(FRAMES).betas, dense)
    colours = (surfels.positions * torch.tensor([2.0, 2.0, 0.6]) + torch.tensor([0.5, 0.5, 0.1])).clamp(0, 1)
    wide = 1.5 * surfels.scales  # the capsule is stretched in the middle; its surface would crack there
    return surfels.replace(colours=colours, scales=wide, occlusion=(surfels.positions[:, 1] > 0).float())


def lpips_file(path: Path) -> None:
    """Random weights in the layout of ``lpips_alex.safetensors``: a metric, though not a trained one."""
    generator = torch.Generator().manual_seed(0)
    shapes = [(64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3)]
    tensors = {}
    for i, (out, before, kernel) in enumerate(shapes):
        tensors[f"conv{i}.weight"] = (
            torch.randn(out, before, kernel, kernel, generator=generator) / kernel / before**0.5
        )
        tensors[f"conv{i}.bias"] = torch.zeros(out)
        tensors[f"head{i}.weight"] = torch.rand(1, out, 1, 1, generator=generator) / out
    write_tensors(path, tensors, {})


def write_sequence(folder: Path, changed: Avatar | None = None) -> dict[str, Path]:
    """Write everything that render, views and evaluate read, photographs being renders of :func:`avatar`.

    Args:
        folder: an empty folder.
        changed: the avatar under test, if it is another than the photographed one.
    """
    body, motion, truth = toy.body(), toy.motion(FRAMES), avatar()
    puppet = Puppet(truth, Articulation.of(body, motion), toy.RASTER)
    cameras = []
    p = toy.PINHOLE
    K = np.array([[p.fx, 0, p.cx], [0, p.fy, p.cy], [0, 0, 1]])
    for name, azimuth in AZIMUTH.items():
        T = toy.camera(azimuth)
        if name == "back":
            T[0, 3] = 0.0
        shots = [Shot.of(puppet.render(t, T, p)) for t in range(FRAMES)]
        write_npz(
            folder / "crops" / f"{name}.npz",
            {
                "rgb": np.stack([to_uint8(composite(s.colour, s.alpha, 0.3)) for s in shots]),
                "alpha": np.stack([to_uint8(s.alpha)[..., 0] for s in shots]),
                "K": np.repeat(K[None], FRAMES, 0),
                "T_cam_from_world": T.numpy(),
                "frame_index": np.arange(FRAMES),
            },
        )
        cameras.append(Camera(name, p.width, p.height, K, T.numpy(), np.zeros(5), "toy"))
    Sequence(
        name="toy",
        fps=10.0,
        frame_ids=tuple(range(10, 10 + FRAMES)),
        up=np.array([0.0, 0.0, 1.0]),
        train=("front",),
        eval=("back",),
        cameras=tuple(cameras),
        sources=(Source("front", "front.mp4", "0" * 64),),
        subject=Subject(None, None, 0, None, "front"),
        remarks=(),
    ).write(folder / "sequence.json")
    body.save(folder / "body_model.npz")
    motion.write(folder / "body.npz")
    shown = truth if changed is None else changed
    shown.write(folder / "avatar.safetensors")
    truth.write(folder / "unrefined.safetensors")
    truth.replace(colours=torch.full_like(truth.colours, 0.5)).write(folder / "paint.safetensors")
    lpips_file(folder / "models" / "lpips_alex.safetensors")
    return {
        "sequence": folder / "sequence.json",
        "body_model": folder / "body_model.npz",
        "body": folder / "body.npz",
        "crops": folder / "crops",
        "avatar": folder / "avatar.safetensors",
        "unrefined": folder / "unrefined.safetensors",
        "paint": folder / "paint.safetensors",
        "models": folder / "models",
    }


def cfg(*groups: str) -> dict:
    """The default options of some groups."""
    return {group: conf(group, "default") for group in groups}
