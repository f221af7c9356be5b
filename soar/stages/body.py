"""Fit the body to keypoints and masks of several cameras, or of the only one; or take the dataset's own.

The fit starts from keypoints in space, or from what others estimated (:mod:`soar.importers`), which may also stay as it
is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.artifacts import ImageArchive, write_image, write_json
from soar.body import measure, pictures
from soar.body.calibrate import angle_between
from soar.body.fit import Fit, FitSettings, fit_body
from soar.body.initial import Poses, points_from_world, pose_from_points
from soar.body.motion import BodyMotion
from soar.body.observations import Observations
from soar.body.openpose import BODY, LIMBS
from soar.body.parameters import HandSpace, motion_of, poses_of, with_face
from soar.body.record import BodyModel
from soar.body.silhouette import Silhouettes
from soar.body.skeleton import collapse
from soar.body.triangulate import triangulate
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.errors import ConfigError
from soar.health import Health
from soar.importers.clip import Clip, subject_in
from soar.importers.providers import Footage, StartSettings, split
from soar.perception.brought import brought_file
from soar.report.pictures import fit, grid, spread
from soar.stages import Job
from soar.stages._subject import archive, archives, calibrated, observe

SHOWN = 5  # frames on the evidence sheet
MEASURED = 25  # frames whose overlap with the mask is measured
CELL = (300, 420)  # width and height of a picture on the sheet, pixels


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the fitted motion, its figures, and the body drawn over frames of every camera."""
    sequence = Sequence.read(inputs["sequence"])
    start, node = split(cfg["body"])
    alone = (node["cameras"] == "train" and len(sequence.train) == 1) or len(sequence.cameras) == 1
    options = settings(FitSettings, monocular(cfg) if alone and start is None else node, "body")
    model = BodyModel.load(inputs["body_model"])
    everyone = observe(inputs, calibrated(inputs, sequence), options.min_confidence)
    masks = archives(inputs["masks"], sequence.names, len(sequence))
    clip = None if start is None else brought(start, inputs, sequence, everyone, model, job.threads)
    if "given" in inputs:
        found = Fit(BodyMotion.read(inputs["given"]), sequence.cameras, [])
    elif clip is not None and start is not None and not start.refine:
        found = Fit(motion_of(clip.parameters, model), everyone.cameras, [])
    else:
        used = everyone.select(sequence.train) if options.cameras == "train" else everyone
        poses = None if clip is None else poses_of(clip.parameters, model)
        found = fitted(model, used, masks, options, sequence.subject.stature_m, poses)
    motion = found.motion if clip is None else with_face(found.motion, clip.parameters)
    motion.write(outputs["body"])
    turned = {camera.name: camera for camera in found.cameras}
    cameras = tuple(turned.get(camera.name, camera) for camera in everyone.cameras)
    write_json(outputs["cameras"], {"cameras": [camera.to_json() for camera in cameras]})
    before, everyone = everyone.cameras, dataclasses.replace(everyone, cameras=cameras)
    frames = archives(inputs["frames"], sequence.names, len(sequence))
    write_image(outputs["evidence"], sheet(model, motion, everyone, frames, sequence.frame_ids))
    health = Health("body")
    figures(health, model, motion, everyone, masks, options.silhouette.threshold)
    for name, value in found.history[-1].items() if found.history else ():
        health.add(f"term_{name}", value)
    for old, new in zip(before, cameras, strict=True):
        health.add(f"turned/{new.name}", np.degrees(angle_between(old.R, new.R)), "degrees")
    if "given" in inputs:
        health.remark("The body and its cameras are the dataset's own; nothing was fitted.")
    elif clip is not None:
        origin(health, clip, model, everyone.select(sequence.train[:1]))
    elif alone:
        health.remark("Fitted to one camera: depth, leaning towards the camera and stature are guesses.")
    health.write(outputs["health"])


def brought(
    start: StartSettings,
    inputs: Mapping[str, Path],
    sequence: Sequence,
    everyone: Observations,
    model: BodyModel,
    threads: int,
) -> Clip:
    """What others estimated of the subject, in every frame of the training camera.

    Raises:
        ConfigError: the body is not SMPL-X; or parameters in a camera's axes, and no telling which camera's.
    """
    if model.name != "smplx":
        raise ConfigError(
            f"body.provider={start.provider}: the parameters are those of SMPL-X", expected="body_model=smplx",
            got=f"body_model={model.name}", cure="choose body_model=smplx and name its file in body_model.source",
        )  # fmt: skip
    seen = everyone.select(sequence.train[:1])
    frames = archive(inputs["frames"] / f"{sequence.train[0]}.zip", len(sequence))
    hands = HandSpace.of(model) if start.hands else None
    path = brought_file(inputs, start.key, "body")
    people = start.archive(Footage(path, seen, frames, sequence.frame_ids, hands, threads))
    if people.of_camera and len(sequence.train) > 1:
        raise ConfigError(
            f"body.provider={start.provider}: these parameters are in the axes of a camera, and there are several",
            expected="one training camera", got=", ".join(sequence.train),
            cure="set dataset.train to the one camera that they are of",
        )  # fmt: skip
    return subject_in(people, sequence.frame_ids, seen, model, start)


def origin(health: Health, clip: Clip, model: BodyModel, seen: Observations) -> None:
    """Add what a start from others was like, in the camera that it is of."""
    points = measure.motion_keypoints(model, motion_of(clip.parameters, model))
    error = measure.reprojection(seen, points)[..., LIMBS]
    health.add("start_reprojection_limbs", np.nanmedian(error), "px")
    health.add("interpolated", clip.interpolated.mean())
    for remark in clip.remarks:
        health.remark(remark)


def fitted(
    model: BodyModel,
    seen: Observations,
    masks: Mapping[str, ImageArchive],
    options: FitSettings,
    stature: float | None,
    start: Poses | None = None,
) -> Fit:
    """Fit from ``start``, or from triangulated points, or from metric landmarks where there is one camera."""
    if start is None:
        start = pose_from_points(model, collapse(model), keypoints_in_space(seen, options), options.initial)
    outlines = None
    if options.silhouette.weight > 0:
        outlines = Silhouettes(seen.cameras, [masks[c.name] for c in seen.cameras], options.silhouette)
    return fit_body(model, seen, start, options, silhouettes=outlines, stature=stature)


def keypoints_in_space(seen: Observations, options: FitSettings) -> np.ndarray:
    """(T, 137, 3) metres, NaN where unknown."""
    if len(seen.cameras) == 1:
        return points_from_world(seen.cameras[0], seen)
    unit = (seen.box_height() / 100)[..., None]
    return triangulate(seen.cameras, seen.points, seen.confidence, unit, options.triangulation)


def monocular(cfg: Mapping[str, Any]) -> dict[str, Any]:
    """The node ``body`` with what the node ``monocular`` changes; a key that it lacks fails the settings' check."""

    def overlaid(node: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
        nested = {k: overlaid(node[k], v) for k, v in over.items() if isinstance(v, Mapping) and k in node}
        return {**node, **over, **nested}

    return overlaid(split(cfg["body"])[1], cfg["monocular"])


def figures(
    health: Health,
    model: BodyModel,
    motion: BodyMotion,
    seen: Observations,
    masks: Mapping[str, ImageArchive],
    threshold: float,
) -> None:
    """Add reprojection errors, mask overlap, jitter and shape of a fit to its health."""
    points = measure.motion_keypoints(model, motion)
    error = measure.reprojection(seen, points)
    for name, part in (("limbs", error[..., LIMBS]), ("body", error[..., : len(BODY)]), ("all", error)):
        health.add(f"reprojection_{name}", np.nanmedian(part), "px")
        health.add(f"reprojection_{name}_p90", np.nanquantile(part, 0.9), "px")
    shown = spread(len(motion), MEASURED)
    overlaps = []
    for c, camera in enumerate(seen.cameras):
        health.add(f"reprojection_limbs/{camera.name}", np.nanmedian(error[c][:, LIMBS]), "px")
        overlap = np.nanmean(measure.mask_overlap(model, motion, camera, masks[camera.name], shown, threshold))
        health.add(f"overlap/{camera.name}", overlap)
        overlaps.append(overlap)
    health.add("overlap", np.nanmean(overlaps))
    health.add("jitter", measure.jitter(points[:, : len(BODY)]), "cm/frame^2")
    health.add("stature", measure.stature(model, motion.betas), "m")
    health.add("largest_beta", motion.betas.abs().max(), "standard deviations")
    health.add("largest_offset", 100 * torch.linalg.norm(motion.keypoint_offsets, dim=1).max(), "cm")


def sheet(
    model: BodyModel,
    motion: BodyMotion,
    seen: Observations,
    frames: Mapping[str, ImageArchive],
    frame_ids: tuple[int, ...],
) -> np.ndarray:
    """The body over frames: one row per camera."""
    shown = spread(len(motion), SHOWN)
    cells, labels = [], []
    for camera in seen.cameras:
        for t in shown:
            vertices = measure.frame_vertices(model, motion, t)
            image = frames[camera.name][t]
            drawn = pictures.draw_body(image, camera, vertices, model)
            cells.append(fit(drawn[pictures.window(camera.project(vertices), image.shape[:2], 0.08)], *CELL))
            labels.append(f"{camera.name}  frame {frame_ids[t]}")
    return grid(cells, len(shown), labels)
