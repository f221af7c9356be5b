"""Front and back normal maps of every crop of one training camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import read_npz, write_image, write_npz
from soar.body.lbs import pose_vertices
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.health import Health
from soar.perception.normals import encode, normal_provider, sign_test
from soar.progress import track
from soar.raster import Pinhole, RasterSettings
from soar.report.pictures import colour_normals, composite, grid
from soar.stages import Job

_SHOWN = 4  # frames on the evidence sheet


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the maps of ``job.camera``, a sheet of some frames, and health."""
    provider = normal_provider(cfg["normals"], settings(RasterSettings, cfg["raster"], "raster"), job.threads)
    model, motion = BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"])
    crops = read_npz(inputs["crops"])
    count, height, width = crops["alpha"].shape
    faces = model.faces[~model.interior]
    pose = torch.from_numpy(np.asarray(crops["T_cam_from_world"], np.float32))
    rotations = motion.rotations

    maps = {side: np.zeros((count, height, width, 3), np.int8) for side in ("front", "back")}
    overlaps, failed = [], []
    for i in track(range(count), f"normals {job.camera}", count):
        frame = int(crops["frame_index"][i])
        world = pose_vertices(model, motion.betas, rotations[frame], motion.translation[frame])
        vertices = world @ pose[:3, :3].T + pose[:3, 3]
        pinhole = Pinhole.from_K(crops["K"][i], width, height)
        front, back = provider.maps(crops["rgb"][i], crops["alpha"][i], vertices, faces, pinhole)
        maps["front"][i], maps["back"][i] = encode(front), encode(back)
        if not sign_test(front, back).passed:
            failed.append(i)
        overlaps.append(_overlap(np.abs(front).max(-1) > 0, crops["alpha"][i] > 127))

    write_npz(outputs["normals"], maps, compress=True)
    shown = np.unique(np.linspace(0, count - 1, _SHOWN).round().astype(int))
    pictures = [
        picture
        for i in shown
        for picture in (
            composite(crops["rgb"][i], crops["alpha"][i]),
            colour_normals(maps["front"][i]),
            colour_normals(maps["back"][i]),
        )
    ]
    labels = [f"{job.camera}  {what} {i + 1} of {count}" for i in shown for what in ("crop", "front", "back")]
    write_image(outputs["evidence"], grid(pictures, 6, labels))

    health = Health("normals")
    health.add("coverage_iou", float(np.mean(overlaps)))
    health.add("coverage_iou_min", float(np.min(overlaps)))
    health.add("sign_test_failed", len(failed) / count)
    if failed:
        health.remark(
            f"Camera {job.camera}: in {len(failed)} of {count} crops the normals fail the sign test (first: crop "
            f"{failed[0] + 1}); the body is out of the picture there, or the maps are in another convention."
        )
    health.write(outputs["health"])


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 0 where both are empty."""
    return float((a & b).sum() / max((a | b).sum(), 1))
