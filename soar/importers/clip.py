"""From the people of an archive to the one person of a clip, in every frame of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from soar.body.observations import Observations
from soar.body.openpose import INDEX
from soar.body.parameters import SmplxParameters, axis_angles, in_world, matrices
from soar.body.record import BodyModel
from soar.errors import InputError
from soar.importers.archive import Archive

_TURNS = ("global_orient", "body_pose", "left_hand", "right_hand", "face")
_ALL = (*_TURNS, "translation", "betas")


@dataclasses.dataclass(frozen=True)
class ClipSettings:
    """How the subject is found in an archive, and what may be missing.

    Attributes:
        reach: people whose pelvis is farther from the subject's hips in the picture are others; in heights of the
            subject's box.
        longest_gap: frames in a row that may be missing and are interpolated.
    """

    reach: float
    longest_gap: int


@dataclasses.dataclass(frozen=True)
class Clip:
    """The subject in every frame of a clip.

    Attributes:
        parameters: in world axes; T frames, numbered as the recording's.
        interpolated: (T,) bool, frames that the archive lacks.
        remarks: sentences the user should read.
    """

    parameters: SmplxParameters
    interpolated: np.ndarray
    remarks: tuple[str, ...]


def subject_in(
    archive: Archive, frame_ids: Sequence[int], seen: Observations, model: BodyModel, options: ClipSettings
) -> Clip:
    """The person whom a camera's keypoints show, in every frame.

    Args:
        archive: the people.
        frame_ids: (T,) numbers of the clip's frames in the recording.
        seen: what the one camera saw that parameters in camera axes belong to.
        model: SMPL-X's record.
        options: see there.

    Raises:
        InputError: nobody in the archive is where the subject is, or it has no frame for a longer time than allowed.
    """
    wanted = np.asarray(frame_ids) + archive.first
    people = [in_world(person, model, seen.cameras[0]) for person in archive.people]
    numbers = np.unique(np.concatenate([person.frames for person in people]))
    if not np.isin(wanted, numbers).any():
        raise InputError(
            "the body parameters are for other frames than the clip's",
            expected=f"frames {wanted[0]} to {wanted[-1]}, those of the recording counted from {archive.first}",
            got=f"{numbers[0]} to {numbers[-1]}, {len(numbers)} in all",
            cure="set body.first_frame to the number that the archive gives to the first frame of the recording",
        )
    found = _nearest(people, wanted, seen, model, options.reach)
    if found is None:
        raise InputError(
            "nobody in the body parameters is where the keypoints show the subject",
            expected=f"a pelvis within {options.reach} heights of the person",
            got=f"{len(people)} people in {len(numbers)} frames, all farther away",
            cure="check that they are of this footage, uncropped, and body.format, body.image_size, body.first_frame; "
            "or raise body.reach",
        )
    parameters, missing = interpolated(found, wanted, options.longest_gap)
    covered = int(np.isin(wanted, numbers).sum())
    remarks = [
        f"Body parameters: {len(numbers)} frames, {numbers[0]} to {numbers[-1]}, the recording's first being "
        f"{archive.first}; "
        f"{len(found)} of the clip's {len(wanted)} are used, {len(numbers) - covered} are beyond the clip."
    ]
    if missing.any():
        remarks.append(
            f"{np.count_nonzero(missing)} frames of the clip are interpolated, the first being frame "
            f"{frame_ids[int(missing.argmax())]}: {covered - len(found)} hold other people only, the others nobody."
        )
    if len(people) > 1:
        remarks.append(f"The body parameters hold {len(people)} people; the one nearest to the subject is taken.")
    betas = model.shapedirs.shape[-1]
    if found.shape is None:
        remarks.append("Their shape is another body's and is not used: the shape starts at the mean.")
    elif np.abs(found.shape[betas:]).max(initial=0) > 0:
        remarks.append(f"Only the first {betas} of their {len(found.shape)} betas are used; see body_model.num_betas.")
    parameters = dataclasses.replace(parameters, frames=np.asarray(frame_ids))
    return Clip(parameters, missing, tuple(remarks))


def _nearest(
    people: Sequence[SmplxParameters], wanted: np.ndarray, seen: Observations, model: BodyModel, reach: float
) -> SmplxParameters | None:
    """Of the ``wanted`` frames those in which somebody is within reach of the subject, as one person; None of none."""
    (camera,) = seen.cameras
    hips, height = _hips(seen), seen.box_height()[0]
    pixels = [camera.project(person.pelvis(model)) for person in people]
    rows = [{int(frame): row for row, frame in enumerate(person.frames)} for person in people]
    picks = []
    for t, frame in enumerate(wanted.tolist()):
        near = [
            (float(np.linalg.norm(pixels[p][rows[p][frame]] - hips[t]) / height[t]), p)
            for p in range(len(people))
            if frame in rows[p]
        ]
        distance, p = min(near, default=(np.inf, 0))
        if distance <= reach:
            picks.append((p, rows[p][frame]))
    if not picks:
        return None
    values: dict[str, Any] = {
        name: None
        if getattr(people[0], name) is None
        else np.stack([getattr(people[p], name)[row] for p, row in picks])
        for name in ("frames", *_ALL)
    }
    return dataclasses.replace(people[0], lever=np.zeros((len(picks), 3, 3)), **values)


def _hips(seen: Observations) -> np.ndarray:
    """(T, 2) middle of the subject's hips in the first camera, pixels; interpolated where it is not seen."""
    sides = [INDEX["left_hip"], INDEX["right_hip"]]
    known = (seen.confidence[0][:, sides] > 0).all(1)
    if not known.any():
        raise InputError("the hips of the subject are never seen", cure="look at the pictures of the keypoint stage")
    frames = np.arange(len(known))
    middle = seen.points[0][:, sides].mean(1)
    return np.stack([np.interp(frames, frames[known], middle[known, i]) for i in (0, 1)], 1)


def interpolated(parameters: SmplxParameters, wanted: np.ndarray, longest: int) -> tuple[SmplxParameters, np.ndarray]:
    """The parameters at the frames ``wanted`` (N,), and which of them (N,) bool are not in the archive.

    Between two frames each joint turns at a constant rate about one axis (slerp), and the rest changes linearly; before
    the first and after the last frame nothing changes.

    Raises:
        InputError: more than ``longest`` frames of those wanted are missing in a row.
    """
    missing = ~np.isin(wanted, parameters.frames)
    run = 0
    for i, gone in enumerate(missing):
        run = run + 1 if gone else 0
        if run > longest:
            raise InputError(
                f"body parameters are missing for more than {longest} frames in a row",
                expected="the subject in nearly every frame", got=f"none from frame {wanted[i - run + 1]} on",
                cure="shorten the clip, estimate the missing frames, or raise body.longest_gap",
            )  # fmt: skip
    after = np.searchsorted(parameters.frames, wanted).clip(0, len(parameters) - 1)
    before = np.where(parameters.frames[after] > wanted, after - 1, after).clip(0)
    a, b = parameters.frames[before], parameters.frames[after]
    share = ((wanted - a) / np.maximum(b - a, 1)).clip(0, 1)
    values: dict[str, Any] = {}
    for name in _ALL:
        value = getattr(parameters, name)
        if value is None:
            continue
        s = share.reshape(-1, *[1] * (value.ndim - 1))
        if name in _TURNS:
            start = matrices(value[before])
            step = axis_angles(start.swapaxes(-1, -2) @ matrices(value[after]))
            values[name] = axis_angles(start @ matrices(s * step))
        else:
            values[name] = (1 - s) * value[before] + s * value[after]
    return dataclasses.replace(parameters, frames=wanted, lever=parameters.lever[before], **values), missing
