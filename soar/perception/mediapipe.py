"""Keypoints from the MediaPipe networks: detector, body twice, hands and face.

The landmark network was trained on crops turned so that the body is upright. A body that leans strongly then looks
like one that stands straight, and the network loses the cue that tells front from back: on a man leaning by 45 degrees
it exchanged left and right in 14 of 50 frames, in crops turned by half the lean in 1 to 6. But at a lean of 60 degrees
such crops are far from what it knows, and limbs are lost. So the direct pass sees the body upright and the mirrored
pass turned by a part of the lean: their mistakes differ, and :mod:`soar.perception.swaps` decides.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from soar.errors import SubjectError
from soar.perception import subject
from soar.perception.assemble import Observation, assemble
from soar.perception.detector import Person, PersonDetector
from soar.perception.face import FaceNetwork
from soar.perception.hands import HandNetwork
from soar.perception.keypoints import Choice, Frames, Keypoints, TrackReport
from soar.perception.mapping import ConfidenceSettings
from soar.perception.pose import PoseNetwork
from soar.perception.roi import Roi
from soar.perception.subject import SubjectSettings
from soar.perception.swaps import SwapSettings
from soar.perception.tracking import TrackingSettings, track
from soar.progress import track as progress


@dataclasses.dataclass(frozen=True)
class MediaPipeSettings:
    """Settings of :class:`MediaPipeKeypoints`; see ``conf/keypoints/mediapipe.yaml``."""

    provider: Literal["mediapipe"]
    model: Literal["full", "heavy"]
    min_detection: float
    min_frames: int
    min_tracked: float
    mirrored_lean: float
    subject: SubjectSettings
    tracking: TrackingSettings
    swaps: SwapSettings
    confidence: ConfidenceSettings


class MediaPipeKeypoints:
    """Estimate one subject's 137 keypoints; implements :class:`~soar.perception.keypoints.KeypointProvider`.

    Args:
        settings: see the conf file.
        models: folder of the ``.onnx`` files.
        threads: threads of one inference.

    Raises:
        ModelFileError: a network is missing or corrupt.
    """

    def __init__(self, settings: MediaPipeSettings, models: Path, threads: int) -> None:
        self._settings = settings
        self._detector = PersonDetector(models / "pose_detection.onnx", threads, settings.min_detection)
        self._pose = PoseNetwork(models / f"pose_landmark_{settings.model}.onnx", threads)
        self._hands = HandNetwork(models, threads)
        self._face = FaceNetwork(models, threads)

    def __call__(self, frames: Frames, choice: Choice | None) -> tuple[Keypoints, TrackReport]:
        """See :meth:`soar.perception.keypoints.KeypointProvider.__call__`."""
        return estimate(frames, choice, self._detector, self._observe, self._settings)

    def _observe(self, image: np.ndarray, roi: Roi) -> Observation:
        pose = self._pose(image, roi)
        return Observation(
            pose=pose,
            mirrored=self._pose(image, roi.straightened(self._settings.mirrored_lean), mirrored=True),
            left_hand=self._hands(image, pose, "left"),
            right_hand=self._hands(image, pose, "right"),
            face=self._face(image, pose),
        )


def estimate(
    frames: Frames,
    choice: Choice | None,
    detect: Callable[[np.ndarray], list[Person]],
    observe: Callable[[np.ndarray, Roi], Observation],
    settings: MediaPipeSettings,
) -> tuple[Keypoints, TrackReport]:
    """Find, choose and follow the subject with the given networks.

    Args:
        frames: the clip.
        choice: the user's word on who the subject is, if any.
        detect: all people of a frame (H, W, 3).
        observe: all estimates of a frame in a region.
        settings: see the conf file.

    Raises:
        SubjectError: nobody, several equally likely people, or too little of one person in view.
    """
    count = len(frames)
    if count < settings.min_frames:
        raise SubjectError(
            "the clip is too short",
            expected=f"at least {settings.min_frames} frames",
            got=str(count),
            cure="give a longer clip or a smaller dataset frame step",
        )
    height, width = frames[0].shape[:2]
    detections = [detect(frames[t]) for t in progress(range(count), "finding people")]
    start = (
        subject.most_prominent(detections, width, height, settings.subject)
        if choice is None
        else subject.chosen(detections, choice)
    )
    followed = track(
        detections,
        start,
        lambda t, roi: observe(frames[t], roi),
        settings.tracking,
        lambda order: progress(order, "keypoints"),
    )
    found = sum(o is not None for o in followed.observations)
    if found < max(settings.min_frames, settings.min_tracked * count):
        raise SubjectError(
            "the subject was found in too few frames",
            expected=f"at least {settings.min_tracked:.0%} of {count} frames, and {settings.min_frames} frames",
            got=f"{found} frames, starting from frame {start.frame}",
            cure=f"cut the clip to where the person is in view, or {subject.CHOOSE}",
        )
    keypoints, swapped = assemble(followed.observations, followed.presence, settings.swaps, settings.confidence)
    remarks = []
    if start.rivalry >= settings.subject.rival_remark:
        remarks.append(
            f"Another person is {start.rivalry:.0%} as prominent as the subject. Look whether the right one is"
            f" followed; otherwise {subject.CHOOSE}."
        )
    return keypoints, TrackReport(start.frame, start.rivalry, followed.reacquired, swapped, tuple(remarks))
