"""The same fit from the first training camera alone, measured against the many-camera body.

A one-camera fit looks right in its own camera whatever its depth; only other cameras tell. This stage says how far the
demo's figures would be from those of a video that the user brings.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image
from soar.body import measure, pictures
from soar.body.fit import FitSettings
from soar.body.motion import BodyMotion
from soar.body.openpose import BODY, INDEX
from soar.body.record import BodyModel
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.report.pictures import fit, grid, spread
from soar.stages import Job, body
from soar.stages._subject import archives, calibrated, observe


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the one-camera motion, its distance to the reference, and both bodies from the side."""
    sequence = Sequence.read(inputs["sequence"])
    options = settings(FitSettings, body.monocular(cfg), "monocular")
    model = BodyModel.load(inputs["body_model"])
    everyone = observe(inputs, calibrated(inputs, sequence), options.min_confidence)
    alone = everyone.select(sequence.train[:1])
    (camera,) = alone.cameras
    masks = archives(inputs["masks"], sequence.names, len(sequence))
    motion = body.fitted(model, alone, masks, options, sequence.subject.stature_m).motion
    motion.write(outputs["body"])

    reference = BodyMotion.read(inputs["reference"])
    health = Health("monocular")
    body.figures(health, model, motion, alone, masks, options.silhouette.threshold)
    _against(health, model, motion, reference, camera)
    if len(sequence.cameras) == 1:
        health.remark("The sequence has one camera: the reference is itself a one-camera fit.")
    health.write(outputs["health"])
    frames = ImageArchive(inputs["frames"] / f"{camera.name}.zip")
    write_image(outputs["evidence"], _sheet(model, motion, reference, camera, frames, sequence))


def _against(health: Health, model: BodyModel, motion: BodyMotion, reference: BodyMotion, camera: Camera) -> None:
    """Add the distances to the reference body, without either fit's keypoint offsets."""
    valid = model.keypoint_valid[: len(BODY)].numpy()
    ours, theirs = (
        measure.motion_keypoints(model, m, offsets=False)[:, : len(BODY)][:, valid] for m in (motion, reference)
    )
    root = int(np.flatnonzero(np.flatnonzero(valid) == INDEX["mid_hip"])[0])
    depth = (camera.to_camera(ours[:, root]) - camera.to_camera(theirs[:, root]))[:, 2]
    health.add("mpjpe", 100 * measure.aligned_error(ours, theirs, root).mean(), "cm")
    health.add("mpjpe_procrustes", 100 * measure.procrustes_error(ours, theirs).mean(), "cm")
    steadiness = [measure.jitter(points) for points in (ours, theirs)]
    health.add("jitter_ratio", steadiness[0] / max(steadiness[1], 1e-9))
    health.add("depth_bias", 100 * depth.mean(), "cm")
    health.add("depth_deviation", 100 * depth.std(), "cm")


def _sheet(
    model: BodyModel,
    motion: BodyMotion,
    reference: BodyMotion,
    camera: Camera,
    frames: ImageArchive,
    sequence: Sequence,
) -> np.ndarray:
    """Above: the body over its own camera's frames. Below: it (orange) and the reference (blue) from the side."""
    shown = spread(len(motion), body.SHOWN)
    over, side, labels = [], [], []
    for t in shown:
        ours, theirs = (measure.frame_vertices(model, m, t) for m in (motion, reference))
        image = frames[t]
        drawn = pictures.draw_body(image, camera, ours, model, pictures.ORANGE)
        over.append(fit(drawn[pictures.window(camera.project(ours), image.shape[:2], 0.08)], *body.CELL))
        view = pictures.side_camera(camera, theirs.mean(0), sequence.up)
        both = pictures.draw_pair(view, [theirs, ours], [pictures.BLUE, pictures.ORANGE], model)
        around = np.concatenate([view.project(theirs), view.project(ours)])
        side.append(fit(both[pictures.window(around, both.shape[:2], 0.08)], *body.CELL))
        labels.append(f"frame {sequence.frame_ids[t]}")
    names = [f"{camera.name}  {name}" for name in labels] + [
        f"from the side, reference blue  {name}" for name in labels
    ]
    return grid(over + side, len(shown), names)
