"""From the 133 keypoints of COCO-WholeBody to the 137 in OpenPose order."""

from __future__ import annotations

import numpy as np

from soar.body.openpose import BODY, COUNT, FACE, LEFT_HAND, RIGHT_HAND

BODY_AND_FEET = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
_AT = {name: i for i, name in enumerate(BODY_AND_FEET)}
WHOLEBODY = 133
_FACE, _LEFT_HAND, _RIGHT_HAND = range(23, 91), range(91, 112), range(112, 133)
_EYES = range(59, 65), range(65, 71)  # lids of the right and of the left eye, whose middle stands for the pupil

_MIDDLES = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}


def _sources() -> list[tuple[int, ...]]:
    """The keypoints of COCO-WholeBody whose middle each of the 137 is."""
    sources: list[tuple[int, ...]] = [()] * COUNT
    for i, name in enumerate(BODY):
        sources[i] = tuple(_AT[source] for source in _MIDDLES.get(name, (name,)))
    for part, members in ((LEFT_HAND, _LEFT_HAND), (RIGHT_HAND, _RIGHT_HAND), (FACE, _FACE)):
        for i, member in enumerate(members):
            sources[part.start + i] = (member,)
    sources[COUNT - 2], sources[COUNT - 1] = (tuple(lids) for lids in _EYES)
    return sources


SOURCES = _sources()


def openpose_137(keypoints: np.ndarray) -> np.ndarray:
    """Keypoints (..., 133, 3), x, y and confidence, as (..., 137, 3).

    Neck, middle of the hips and pupils are the middle of their neighbours, and as certain as the least certain of them.
    """
    parts = [keypoints[..., list(source), :] for source in SOURCES]
    return np.stack([np.concatenate([p[..., :2].mean(-2), p[..., 2].min(-1)[..., None]], -1) for p in parts], axis=-2)
