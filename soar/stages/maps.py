"""What the dataset knows of one camera's frames: alpha, normals of the clothed person and of the body, depth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image, write_planes
from soar.datasets import known
from soar.datasets.planes import normals_of, picture_of
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.perception.diagnostics import mask_figures
from soar.progress import track
from soar.report.pictures import colour_normals, fit, grid, spread
from soar.stages import Job

_SHOWN = 2  # frames on the evidence sheet
_CELL = 300  # pixels


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the planes of ``job.camera`` that the dataset knows, their health, and a sheet of some frames."""
    sequence, truth = Sequence.read(inputs["sequence"]), known(cfg["dataset"], job.sequence)
    camera, figures, averted = sequence.camera(str(job.camera)), [], []

    def drawn() -> Iterator[dict[str, np.ndarray]]:
        for t in track(sequence.frame_ids, f"maps {camera.name}"):
            planes = truth.planes(camera, t)
            figures.append(mask_figures(planes["alpha"]))
            if "front" in planes:
                averted.append(_averted(planes["front"], planes["back"]))
            yield {name: picture_of(name, plane) for name, plane in planes.items()}

    write_planes(outputs["maps"], drawn())
    write_image(outputs["evidence"], _sheet(outputs["maps"], sequence, camera.name))
    health = Health("maps")
    health.add("empty_frames", np.mean([figure.area == 0 for figure in figures]))
    health.add("area", np.median([figure.area for figure in figures]), "px^2")
    health.add("border_contact", np.mean([figure.at_border for figure in figures]))
    if averted:
        health.add("normals_averted", np.mean(averted))
    health.write(outputs["health"])


def _averted(front: np.ndarray, back: np.ndarray) -> float:
    """Share of normals that lean to the wrong side: away from the camera in front, towards it behind."""
    inside = np.abs(front).max(-1) > 0
    return float(np.mean((front[inside][:, 2] > 0) | (back[inside][:, 2] < 0))) if inside.any() else 0.0


def _sheet(path: Path, sequence: Sequence, camera: str) -> np.ndarray:
    cells, labels = [], []
    shown = spread(len(sequence), _SHOWN)
    for t in shown:
        for plane in ("alpha", "front", "back", "body_front", "body_back", "depth"):
            archive = ImageArchive(path, plane)
            if len(archive):
                cells.append(fit(_visible(plane, archive[t]), _CELL, _CELL))
                labels.append(f"{camera}  frame {sequence.frame_ids[t]}  {plane.replace('_', ' ')}")
    return grid(cells, len(cells) // len(shown), labels)


def _visible(plane: str, picture: np.ndarray) -> np.ndarray:
    """A plane as a picture; of depth, near is bright."""
    if plane == "depth":
        inside = picture > 0
        near, far = (picture[inside].min(), picture[inside].max()) if inside.any() else (0, 1)
        return np.where(inside, 1 - 0.8 * (picture.astype(np.float32) - near) / max(far - near, 1), 0)
    return picture if plane == "alpha" else colour_normals(normals_of(picture))
