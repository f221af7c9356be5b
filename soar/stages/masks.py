"""The subject in every frame of one camera as a soft mask: estimated, made elsewhere, or the dataset's own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image, write_images
from soar.body.openpose import BODY
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.errors import ArtifactError
from soar.health import Health
from soar.perception.apart import Apart
from soar.perception.brought import brought_file
from soar.perception.diagnostics import MaskFigures, area_jitter, mask_figures
from soar.perception.keypoints import Keypoints
from soar.perception.mask_files import MaskFiles, MaskFileSettings
from soar.perception.masks import MaskProvider
from soar.perception.pose import PoseNetwork
from soar.perception.registry import mask_provider
from soar.perception.roi import Roi
from soar.progress import track
from soar.report.pictures import composite, fit, grid, overlay_mask, spread, to_uint8
from soar.stages import Job
from soar.stages._subject import archive

_SHOWN = 6  # frames on the evidence sheet
_CELL = (360, 480)  # width and height of a picture on the sheet, pixels
_MAGENTA = (1.0, 0.0, 1.0)


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the masks of ``job.camera``, their health, and a sheet of outlines and cut-outs."""
    sequence, frames = Sequence.read(inputs["sequence"]), ImageArchive(inputs["frames"])
    record = Keypoints.read(inputs["keypoints"])
    if len(record.score) != len(frames):
        raise ArtifactError(
            f"{inputs['keypoints']} does not belong to these frames",
            expected=f"{len(frames)} frames",
            got=str(len(record.score)),
            cure="delete the file and run snakemake; it is made again",
        )
    found: Iterator[np.ndarray]
    apart: Apart | None = None
    if "given" in inputs:
        found = (alpha / np.float32(255) for alpha in archive(inputs["given"], len(frames), "alpha"))
    elif cfg["masks"].get("provider") == "files":
        options, source = settings(MaskFileSettings, cfg["masks"], "masks"), brought_file(inputs, "source", "masks")
        found = MaskFiles(options, source, sequence, str(job.camera)).masks(record.keypoints[:, : len(BODY)])
    else:
        if record.company.any():
            apart = Apart(frames, record, PoseNetwork(inputs["models"] / "pose_landmark_full.onnx", job.threads))
        found = _estimated(frames, record, mask_provider(cfg["masks"], inputs, job.threads), apart)
    figures: list[MaskFigures] = []
    write_images(outputs["masks"], _measured(track(found, "masks", len(frames)), figures), ".png")
    write_image(outputs["evidence"], _sheet(frames, ImageArchive(outputs["masks"]), sequence.frame_ids))
    health = _health(figures, sequence.frame_ids)
    if apart is not None and not apart.learned:
        health.remark("Somebody else is beside the subject throughout: masks may hold parts of them.")
    health.write(outputs["health"])


def _estimated(
    frames: ImageArchive, record: Keypoints, estimate: MaskProvider, apart: Apart | None
) -> Iterator[np.ndarray]:
    """Masks (H, W) float32 in [0, 1] one at a time and in order, so that memory does not grow with the clip and a
    provider may go by the frames before; it is not asked about frames without the subject.
    """
    for t, image in enumerate(frames):
        if record.present[t]:
            alpha = estimate(image, Roi(*map(float, record.roi[t])), record.keypoints[t, : len(BODY)])
            yield alpha if apart is None else apart(t, image, alpha)
        else:
            yield np.zeros(image.shape[:2], np.float32)


def _measured(masks: Iterable[np.ndarray], figures: list[MaskFigures]) -> Iterator[np.ndarray]:
    """The masks as uint8; their figures are appended."""
    for alpha in masks:
        figures.append(mask_figures(alpha))
        yield np.round(alpha * 255).astype(np.uint8)


def _sheet(frames: ImageArchive, masks: ImageArchive, frame_ids: tuple[int, ...]) -> np.ndarray:
    shown = spread(len(frames), _SHOWN)
    pictures = []
    for t in shown:
        image, alpha = frames[t], masks[t]
        rows, columns = (np.flatnonzero((alpha > 127).any(axis)) for axis in (1, 0))
        if len(rows):
            margin = 20 + len(rows) // 20
            box = tuple(slice(max(0, i[0] - margin), i[-1] + margin) for i in (rows, columns))
            image, alpha = image[box], alpha[box]
        pictures += [overlay_mask(image, alpha, opacity=0.0), to_uint8(composite(image, alpha, _MAGENTA))]
    labels = [f"frame {frame_ids[t]}" for t in np.repeat(shown, 2)]
    return grid([fit(p, *_CELL) for p in pictures], 4, labels)


def _health(figures: list[MaskFigures], frame_ids: tuple[int, ...]) -> Health:
    health = Health("masks")
    areas = np.array([f.area for f in figures], float)
    full = [f for f in figures if f.area]
    empty = [frame_ids[t] for t in np.flatnonzero(areas == 0)]
    border = np.mean([f.at_border for f in full]) if full else float("nan")
    health.add("empty_frames", len(empty) / len(figures))
    health.add("area", np.median(areas[areas > 0]) if full else float("nan"), "px^2")
    health.add("area_jitter", area_jitter(areas))
    health.add("components", np.mean([f.components for f in full]) if full else float("nan"))
    health.add("border_contact", border)
    if empty:
        health.remark(f"The mask is empty in {len(empty)} of {len(figures)} frames, the first being frame {empty[0]}.")
    if border > 0:
        health.remark(f"The mask touches the image border in {border:.0%} of the frames: the person may be cut off.")
    return health
