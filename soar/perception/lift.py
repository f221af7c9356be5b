"""What keypoints of other networks lack: the region round the body, metric landmarks, and sides that stay the same.

BlazePose looks once more at the region that the keypoints span. Its metric landmarks are taken where it sees the same
person; its depth tells limbs apart that cross in the image, by which exchanges of left and right are undone as in
:mod:`soar.perception.swaps`.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from soar.body.openpose import BODY, INDEX, LIMBS
from soar.errors import InputError
from soar.perception import mapping, swaps
from soar.perception.detector import pose_roi
from soar.perception.keypoints import Frames, Keypoints
from soar.perception.pose import LANDMARKS, Pose, PoseNetwork
from soar.perception.roi import Roi
from soar.progress import track as progress

# BODY_25 keypoint that each BlazePose landmark is, or the nearest there is.
_NEAREST = {
    **{f"{side}_eye_{part}": f"{side}_eye" for side in ("left", "right") for part in ("inner", "outer")},
    **{f"{side}_{finger}": f"{side}_wrist" for side in ("left", "right") for finger in ("pinky", "index", "thumb")},
    **{f"{side}_foot_index": f"{side}_big_toe" for side in ("left", "right")},
    "mouth_left": "nose",
    "mouth_right": "nose",
}
_SOURCE = np.array([INDEX[_NEAREST.get(name, name)] for name in LANDMARKS])
OWN = np.array([name in BODY or name.endswith("foot_index") for name in LANDMARKS])
"""(33,) bool, which landmarks are keypoints of BODY_25, not just near one."""


@dataclasses.dataclass(frozen=True)
class LiftSettings:
    """How BlazePose is asked, and when it is believed.

    Attributes:
        model: which of its networks.
        min_presence: probability in [0, 1] that it sees a person.
        same_person: in sides of the region: median distance to the keypoints, from which it sees somebody else.
        min_agreement: share of the frames with keypoints in which it must see the same person.
    """

    model: Literal["full", "heavy"]
    min_presence: float
    same_person: float
    min_agreement: float


def landmarks(body: np.ndarray) -> np.ndarray:
    """BODY_25 (..., 25, D) to BlazePose's 33 (..., 33, D): the same point, or the nearest there is."""
    return body[..., _SOURCE, :]


def body_region(body: np.ndarray) -> Roi | None:
    """The region round a body, as the pose network is given it.

    A circle about the hips through the farthest keypoint, turned with the trunk; without hips, about the box around all
    keypoints, upright.

    Args:
        body: (25, 3) x, y in pixels and confidence, 0 where not seen.

    Returns:
        None where no two keypoints are seen in different places.
    """
    seen = body[body[:, 2] > 0, :2]
    if len(seen) < 2:
        return None
    hips, chest = (
        _middle(body, *names)
        for names in (("mid_hip", "right_hip", "left_hip"), ("neck", "right_shoulder", "left_shoulder"))
    )
    centre = (seen.min(0) + seen.max(0)) / 2 if hips is None else hips
    radius = np.linalg.norm(seen - centre, axis=1).max()
    up = np.array([0.0, -1.0])
    if hips is not None and chest is not None and np.linalg.norm(chest - hips) > 0:
        up = (chest - hips) / np.linalg.norm(chest - hips)
    roi = pose_roi(centre, centre + radius * up)
    return roi if roi.usable else None


def _middle(body: np.ndarray, middle: str, *sides: str) -> np.ndarray | None:
    """A keypoint (2,) if it is seen, else the middle of those beside it that are; None without any."""
    for names in ((middle,), sides):
        seen = [body[INDEX[name], :2] for name in names if body[INDEX[name], 2] > 0]
        if seen:
            return np.mean(seen, axis=0)
    return None


def lift(
    frames: Frames,
    passes: np.ndarray,
    others: np.ndarray,
    network: PoseNetwork,
    options: LiftSettings,
    swap_settings: swaps.SwapSettings,
    trust: float,
) -> tuple[Keypoints, np.ndarray, list[str]]:
    """Complete the keypoints of one subject.

    Args:
        frames: the clip.
        passes: (P, T, 137, 3) keypoints: one pass, or a direct and a mirrored one; zeros where nobody was found.
        others: see :attr:`soar.perception.keypoints.Keypoints.others`.
        network: BlazePose.
        options, swap_settings: see there.
        trust: in torso lengths: passes that differ by more are trusted less.

    Returns:
        the record; (T, 3) bool, the exchanges of head, arms and legs that were undone; remarks.

    Raises:
        InputError: the keypoints do not lie on the person in the frames.
    """
    keypoints, count = passes[0].copy(), passes.shape[1]
    world, roi, guides = np.zeros((count, 33, 3)), np.zeros((count, 4)), np.zeros((count, 33, 2))
    for t in progress(range(count), "metric landmarks"):
        body = keypoints[t, : len(BODY)]
        region = body_region(body)
        if region is not None:
            roi[t] = dataclasses.astuple(region)
            guides[t], world[t] = _alike(network(frames[t], region), body, region, options)
    found = np.flatnonzero(roi[:, 2] > 0)
    keypoints[roi[:, 2] == 0] = 0
    known = np.any(world[found], axis=(1, 2))
    _check(known, options.min_agreement)
    swapped, disagreement = np.zeros((count, len(swaps.SETS)), bool), np.zeros((count, len(BODY)))
    keypoints[found], swapped[found], disagreement[found] = _consistent(
        passes[:, found], guides[found], world[found, :, 2], swap_settings, trust
    )
    record = Keypoints(
        keypoints.astype(np.float32),
        swaps.relabelled(world, swapped).astype(np.float32),
        roi.astype(np.float32),
        keypoints[:, list(LIMBS), 2].mean(1).astype(np.float32),
        disagreement.astype(np.float32),
        others,
    )
    missing = len(found) - int(known.sum())
    remark = f"In {missing} of {len(found)} frames there are no metric landmarks: BlazePose does not see the person."
    return record, swapped, [remark] if missing else []


def _check(known: np.ndarray, least: float) -> None:
    if not known.size or known.mean() < least:
        raise InputError(
            "the keypoints do not lie on the person in the frames",
            expected=f"that BlazePose sees a person of these keypoints in {least:.0%} of the frames",
            got=f"{int(known.sum())} of {len(known)} frames",
            cure="check that the keypoints, or the network and its boxes, belong to this footage at this size;"
            " see keypoints.lift",
        )


def _alike(pose: Pose, body: np.ndarray, region: Roi, options: LiftSettings) -> tuple[np.ndarray, np.ndarray]:
    """Image (33, 2) and metric (33, 3) landmarks with the keypoints' sides; metres are zero of somebody else."""
    points, seen = landmarks(body[:, :2]), landmarks(body[:, 2:])[:, 0] > 0
    sets = swaps.exchanged(np.where(seen[:, None], points, pose.points), pose.points)[None]
    theirs, metres = swaps.relabelled(pose.points[None], sets)[0], swaps.relabelled(pose.world[None], sets)[0]
    seen &= OWN
    apart = np.median(np.linalg.norm(points - theirs, axis=-1)[seen]) if seen.any() else np.inf
    known = pose.presence >= options.min_presence and apart <= options.same_person * region.side
    return theirs, metres if known else np.zeros_like(metres)


def _consistent(
    passes: np.ndarray, guides: np.ndarray, depth: np.ndarray, settings: swaps.SwapSettings, trust: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keypoints (F, 137, 3) with one set of sides throughout, what was exchanged, and the passes' distance (F, 25)."""
    body = passes[:, :, : len(BODY)]
    both = np.where(landmarks(body[..., 2:]) > 0, landmarks(body[..., :2]), guides)
    first, second = both[0], both[-1]
    source, sets = swaps.resolve(np.stack([first, second]), np.stack([depth, depth]), settings)
    at = np.arange(len(source))
    chosen = swaps.exchange(passes[np.minimum(source, len(passes) - 1), at], sets)
    points = swaps.relabelled(np.stack([first, second])[source, at], sets)
    swapped = swaps.exchanged(points, first)
    if len(passes) == 1:
        return chosen, swapped, np.zeros(body.shape[1:3])
    other = passes[1 - source, at]
    other = swaps.exchange(other, swaps.exchanged(points, np.stack([second, first])[source, at]))
    apart = np.linalg.norm(chosen[..., :2] - other[..., :2], axis=-1)
    limit = trust * np.linalg.norm(swaps.torso(points), axis=-1, keepdims=True)
    agreement = mapping.agreement(apart, limit)
    # The mean of two passes is steadier than either; where they differ the second one counts less.
    share = np.where(other[..., 2] > 0, agreement, 0)[..., None] / 2
    chosen[..., :2] += share * (other[..., :2] - chosen[..., :2])
    chosen[..., 2] *= agreement
    return chosen, swapped, apart[:, : len(BODY)]
