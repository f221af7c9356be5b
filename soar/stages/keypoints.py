"""The 137 keypoints of the subject in every frame of one camera: estimated, or those of the dataset's own body."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image
from soar.body.motion import BodyMotion
from soar.body.openpose import BODY
from soar.body.record import BodyModel
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.perception import diagnostics
from soar.perception.drawing import draw_skeleton
from soar.perception.given import projected
from soar.perception.keypoints import Choice, Keypoints, TrackReport
from soar.perception.registry import keypoint_provider
from soar.report.pictures import fit, grid, spread
from soar.stages import Job

_SHOWN = 6  # frames on the evidence sheet
_HEIGHT = 640  # of a frame on the sheet, pixels


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the keypoints of ``job.camera``, their health, and a sheet of frames with the skeleton over them."""
    sequence, frames = Sequence.read(inputs["sequence"]), ImageArchive(inputs["frames"])
    if "given" in inputs:
        model, motion = BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["given"])
        record, report = projected(model, motion, sequence.camera(str(job.camera)))
    else:
        subject = sequence.subject
        told = job.camera == subject.camera and (subject.point is not None or subject.box is not None)
        estimate = keypoint_provider(cfg["keypoints"], Path(inputs["models"]), job.threads)
        record, report = estimate(frames, Choice(subject.frame, subject.point, subject.box) if told else None)
    record.write(outputs["keypoints"])
    write_image(outputs["evidence"], _sheet(frames, record, sequence.frame_ids))
    _health(record, report, sequence.frame_ids).write(outputs["health"])


def _sheet(frames: ImageArchive, record: Keypoints, frame_ids: tuple[int, ...]) -> np.ndarray:
    shown = spread(len(frames), _SHOWN)
    body = record.keypoints[record.present][:, : len(BODY)]
    places = body[body[..., 2] > 0][:, :2]
    height, width = frames[0].shape[:2]
    margin = 0.1 * np.ptp(places, axis=0).max()
    x0, y0 = np.maximum(np.floor(places.min(0) - margin), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(places.max(0) + margin), (width, height)).astype(int)
    line = 3 * (y1 - y0) / _HEIGHT
    pictures = [draw_skeleton(frames[t], record.keypoints[t], line)[y0:y1, x0:x1] for t in shown]
    labels = [f"frame {frame_ids[t]}" + ("" if record.present[t] else "  nobody") for t in shown]
    cell = round((x1 - x0) * _HEIGHT / (y1 - y0))
    return grid([fit(p, cell, _HEIGHT) for p in pictures], 3, labels)


def _health(record: Keypoints, report: TrackReport, frame_ids: tuple[int, ...]) -> Health:
    health, present = Health("keypoints"), record.present
    swaps = int(report.swapped.any(1).sum())
    health.add("present", present.mean())
    health.add("score", record.score[present].mean())
    health.add("swaps_corrected", swaps, "frames")
    health.add("disagreement", diagnostics.disagreement(record), "torso lengths")
    health.add("jitter", diagnostics.jitter(record), "torso lengths")
    health.add("reacquired", report.reacquired, "frames")
    health.add("rivalry", report.rivalry)
    if not present.all():
        lost = [frame_ids[t] for t in np.flatnonzero(~present)]
        health.remark(
            f"The subject was not found in {len(lost)} of {len(present)} frames, the first being frame {lost[0]}."
        )
    if swaps:
        health.remark(f"Left and right were exchanged in {swaps} of {len(present)} frames and set right.")
    for remark in report.remarks:
        health.remark(remark)
    return health
