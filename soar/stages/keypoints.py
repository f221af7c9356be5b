"""The 137 keypoints of the subject in every frame of one camera: estimated, or those of the dataset's own body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image
from soar.body.motion import BodyMotion
from soar.body.openpose import BODY
from soar.body.record import BodyModel
from soar.datasets.sequence import Sequence
from soar.errors import SubjectError
from soar.health import Health
from soar.perception import diagnostics
from soar.perception.drawing import draw_person, draw_skeleton
from soar.perception.given import projected
from soar.perception.keypoints import Choice, Keypoints, TrackReport
from soar.perception.registry import keypoint_provider
from soar.perception.roi import Roi
from soar.perception.subject import Undecided
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
        record, report = _estimated(frames, sequence, inputs, outputs, cfg["keypoints"], job)
    record.write(outputs["keypoints"])
    write_image(outputs["evidence"], _sheet(frames, record, sequence.frame_ids))
    _health(record, report, sequence.frame_ids).write(outputs["health"])


def _estimated(
    frames: ImageArchive,
    sequence: Sequence,
    inputs: Mapping[str, Path],
    outputs: Mapping[str, Path],
    node: Mapping[str, Any],
    job: Job,
) -> tuple[Keypoints, TrackReport]:
    """The provider's keypoints. Where it cannot tell who the subject is, a picture of the people stays behind."""
    subject, camera = sequence.subject, str(job.camera)
    told = camera == subject.camera and (subject.point is not None or subject.box is not None)
    estimate = keypoint_provider(node, inputs, job.threads, sequence, camera)
    picture = outputs["evidence"].with_name(f"{camera}.doubt.jpg")
    picture.unlink(missing_ok=True)
    try:
        return estimate(frames, Choice(subject.frame, subject.point, subject.box) if told else None)
    except Undecided as doubt:
        write_image(picture, _people(frames[doubt.frame], doubt.people))
        raise SubjectError(
            doubt.what, expected=doubt.expected, got=f"{doubt.got}; see {picture}", cure=doubt.cure
        ) from doubt


def _people(image: np.ndarray, people: Iterable[Roi]) -> np.ndarray:
    """A frame with everybody's region and the pixel at its centre."""
    for roi in people:
        image = draw_person(image, roi, 3 * image.shape[0] / _HEIGHT, f"[{roi.cx:.0f},{roi.cy:.0f}]")
    return image


def _shown(record: Keypoints) -> list[int]:
    """Frames for the sheet: spread over the clip and, if somebody else comes near, frames with one of them hidden."""
    company = record.company
    if not company.any():
        return spread(len(company), _SHOWN)
    hidden = company & (~record.present | ((record.others[..., 2] > 0) & (record.others[..., 4] == 0)).any(1))
    chosen = spread(len(company), _SHOWN // 2)
    doubtful = np.setdiff1d(np.flatnonzero(hidden if hidden.any() else company), chosen)
    if len(doubtful):
        chosen = [*chosen, *doubtful[spread(len(doubtful), _SHOWN // 2)].tolist()]
    return sorted(chosen)


def _sheet(frames: ImageArchive, record: Keypoints, frame_ids: tuple[int, ...]) -> np.ndarray:
    body = record.keypoints[record.present][:, : len(BODY)]
    places = body[body[..., 2] > 0][:, :2]
    height, width = frames[0].shape[:2]
    margin = 0.1 * np.ptp(places, axis=0).max()
    x0, y0 = np.maximum(np.floor(places.min(0) - margin), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(places.max(0) + margin), (width, height)).astype(int)
    line = 3 * (y1 - y0) / _HEIGHT
    pictures, labels = [], []
    for t in _shown(record):
        picture = draw_skeleton(frames[t], record.keypoints[t], line)
        for cx, cy, side, rotation, seen in record.others[t].tolist():
            if side > 0:
                picture = draw_person(picture, Roi(cx, cy, side, rotation), line / 2, "", broken=not seen)
        pictures.append(picture[y0:y1, x0:x1])
        labels.append(f"frame {frame_ids[t]}" + ("" if record.present[t] else "  nobody"))
    cell = round((x1 - x0) * _HEIGHT / (y1 - y0))
    return grid([fit(p, cell, _HEIGHT) for p in pictures], 3, labels)


def _health(record: Keypoints, report: TrackReport, frame_ids: tuple[int, ...]) -> Health:
    health, present = Health("keypoints"), record.present
    swaps = int(report.swapped.any(1).sum())
    health.add("present", present.mean())
    health.add("score", record.score[present].mean())
    health.add("swaps_corrected", swaps, "frames")
    if record.disagreement.any():
        health.add("disagreement", diagnostics.disagreement(record), "torso lengths")
    health.add("jitter", diagnostics.jitter(record), "torso lengths")
    health.add("reacquired", report.reacquired, "frames")
    health.add("rivalry", report.rivalry)
    if not present.all():
        lost = [frame_ids[t] for t in np.flatnonzero(~present)]
        health.remark(
            f"The subject was not found in {len(lost)} of {len(present)} frames, the first being frame {lost[0]}."
        )
    if hidden := int((record.company & ~present).sum()):
        health.remark(f"In {hidden} of them somebody else was near, who probably hid the subject.")
    if swaps:
        health.remark(f"Left and right were exchanged in {swaps} of {len(present)} frames and set right.")
    for remark in report.remarks:
        health.remark(remark)
    return health
