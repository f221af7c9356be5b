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

from soar.body import openpose
from soar.perception import mapping
from soar.perception.assemble import Observation, assemble
from soar.perception.detector import Person, PersonDetector
from soar.perception.face import FaceNetwork
from soar.perception.following import FollowSettings, follow
from soar.perception.hands import HandNetwork
from soar.perception.keypoints import Choice, Frames, Keypoints, TrackReport
from soar.perception.mapping import ConfidenceSettings
from soar.perception.pose import INDEX, LANDMARKS, Pose, PoseNetwork
from soar.perception.roi import Roi
from soar.perception.swaps import SwapSettings
from soar.perception.tracking import Track
from soar.progress import track as progress


@dataclasses.dataclass(frozen=True)
class MediaPipeSettings(FollowSettings):
    """Settings of :class:`MediaPipeKeypoints`; see ``conf/keypoints/mediapipe.yaml``."""

    provider: Literal["mediapipe"]
    model: Literal["full", "heavy"]
    min_detection: float
    mirrored_lean: float
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
        return estimate(frames, choice, self._detector, self._observe, self._pose, self._settings)

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
    glance: Callable[[np.ndarray, Roi], Pose],
    settings: MediaPipeSettings,
) -> tuple[Keypoints, TrackReport]:
    """Find, choose and follow the subject with the given networks.

    Args:
        frames: the clip.
        choice: the user's word on who the subject is, if any.
        detect: all people of a frame (H, W, 3).
        observe: all estimates of a frame in a region.
        glance: the pose alone, for the people near the subject.
        settings: see the conf file.

    Raises:
        SubjectError: nobody, several equally likely people, or too little of one person in view.
    """
    height, width = frames[0].shape[:2]
    followed = follow(
        [detect(frames[t]) for t in progress(range(len(frames)), "finding people")],
        (width, height),
        choice,
        lambda t, roi: observe(frames[t], roi),
        lambda t, roi: glance(frames[t], roi),
        settings,
        lambda order: progress(order, "keypoints"),
    )
    found = followed.track
    keypoints, swapped = assemble(found.observations, found.presence, settings.swaps, settings.confidence)
    trust = own_keypoints(found, settings.confidence.shared)
    keypoints.keypoints[..., 2] *= trust
    report = TrackReport(followed.start.frame, followed.start.rivalry, found.reacquired, swapped, followed.remarks)
    return dataclasses.replace(keypoints, others=followed.others), report


def own_keypoints(found: Track[Observation, Pose], shared: float) -> np.ndarray:
    """(T, 137) of which keypoints nobody else near the subject has a landmark in the same place: 1, the others 0.

    Args:
        found: the subject and the people near them.
        shared: distance below which two people's landmarks are in one place, in sides of the subject's region.
    """
    own = np.ones((len(found.observations), len(LANDMARKS)))
    for t, (seen, others) in enumerate(zip(found.observations, found.others, strict=True)):
        for other in others:
            if seen is not None and other.estimate is not None:
                apart = np.linalg.norm(seen.pose.points - other.estimate.points, axis=-1)
                own[t, apart < shared * seen.pose.roi.side] = 0
    trust = np.ones((len(own), openpose.COUNT))
    trust[:, : len(openpose.BODY)] = mapping.body_confidence(own, 1.0)
    for part, landmark in (
        (openpose.LEFT_HAND, "left_wrist"),
        (openpose.RIGHT_HAND, "right_wrist"),
        (openpose.FACE, "nose"),
    ):
        trust[:, part] = own[:, INDEX[landmark], None]
    return trust
