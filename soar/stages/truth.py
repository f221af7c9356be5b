"""What the dataset knows of the person: the body in motion, and which of its surface the training cameras ever see."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import write_image, write_npz
from soar.body import measure, pictures
from soar.body.lbs import rest_vertices
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.datasets import known
from soar.datasets.sequence import Sequence
from soar.geometry.meshes import face_normals
from soar.health import Health
from soar.progress import track
from soar.report.pictures import SEEN, UNSEEN, fit, grid
from soar.stages import Job

_CELL = (300, 420)  # width and height of a picture on the sheet, pixels


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the motion, the surface seen, their health, and the body from all cameras, red where it is never seen."""
    sequence, truth = Sequence.read(inputs["sequence"]), known(cfg["dataset"], job.sequence)
    model, motion = BodyModel.load(inputs["body_model"]), truth.body(sequence.frame_ids)
    motion.write(outputs["body"])
    seen = np.stack(
        [
            np.any([truth.seen(sequence.camera(name), t) for name in sequence.train], axis=0)
            for t in track(sequence.frame_ids, "surface seen")
        ]
    )
    exterior, area = surface(model, motion)
    write_npz(outputs["surface"], {"seen": seen, "exterior": exterior, "area": area}, compress=True)
    write_image(outputs["evidence"], _sheet(model, motion, sequence, seen.any(0) | ~exterior))
    _health(sequence, model, motion, seen[:, exterior], area[exterior]).write(outputs["health"])


def surface(model: BodyModel, motion: BodyMotion) -> tuple[np.ndarray, np.ndarray]:
    """(V,) bool, whether a vertex is on the outside of the body, and (V,) float32 its share of that, square metres."""
    faces, vertices = model.faces[~model.interior], rest_vertices(model, motion.betas)
    area = torch.zeros(len(vertices))
    third = torch.linalg.norm(face_normals(vertices, faces), dim=-1) / 6
    for corner in faces.T:
        area.index_add_(0, corner, third)
    return (area > 0).numpy(), area.numpy()


def _health(sequence: Sequence, model: BodyModel, motion: BodyMotion, seen: np.ndarray, area: np.ndarray) -> Health:
    health, never = Health("truth"), ~seen.any(0)
    health.add("bor", never.mean())
    health.add("bor_area", area[never].sum() / area.sum())
    health.add("seen_at_once", (seen @ area).mean() / area.sum())
    for name in sequence.train:
        health.add(f"turned_away/{name}", measure.turned_away(model, motion, sequence.camera(name)).max(), "degrees")
    health.add("stature", measure.stature(model, motion.betas), "m")
    return health


def _sheet(model: BodyModel, motion: BodyMotion, sequence: Sequence, seen: np.ndarray) -> np.ndarray:
    t = len(motion) // 2
    vertices = measure.frame_vertices(model, motion, t)
    colours = 255 * np.where(seen[:, None], SEEN, UNSEEN).astype(np.float32)
    cells = []
    for camera in sequence.cameras:
        white = np.full((camera.height, camera.width, 3), 255, np.uint8)
        drawn = pictures.draw_body(white, camera, vertices, model, colours, opacity=1.0)
        cells.append(fit(drawn[pictures.window(camera.project(vertices), drawn.shape[:2], 0.08)], *_CELL))
    return grid(cells, len(cells), [f"{camera.name}  frame {sequence.frame_ids[t]}" for camera in sequence.cameras])
