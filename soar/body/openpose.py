"""Names and groups of the 137 keypoints: 25 body, 21 left hand, 21 right hand, 70 face (OpenPose order).

Left and right are the subject's. The face follows the 68 iBUG landmarks (jaw first, from the subject's right ear)
and closes with the two pupils.
"""

from __future__ import annotations

import numpy as np

BODY = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
    "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
)  # fmt: skip
FINGERS = ("thumb", "index", "middle", "ring", "little")


def _hand(side: str) -> tuple[str, ...]:
    return (f"{side}_hand_wrist", *(f"{side}_{finger}_{k}" for finger in FINGERS for k in (1, 2, 3, 4)))


def _face() -> tuple[str, ...]:
    parts = (
        ("jaw", 17), ("right_brow", 5), ("left_brow", 5), ("nose_bridge", 4), ("nostril", 5), ("right_eye_lid", 6),
        ("left_eye_lid", 6), ("outer_lip", 12), ("inner_lip", 8),
    )  # fmt: skip
    return (*(f"{part}_{i}" for part, count in parts for i in range(count)), "right_pupil", "left_pupil")


NAMES: tuple[str, ...] = (*BODY, *_hand("left"), *_hand("right"), *_face())
COUNT = len(NAMES)
INDEX: dict[str, int] = {name: i for i, name in enumerate(NAMES)}

LEFT_HAND = slice(25, 46)
RIGHT_HAND = slice(46, 67)
FACE = slice(67, 137)

LIMBS: tuple[int, ...] = tuple(
    INDEX[f"{side}_{joint}"]
    for side in ("left", "right")
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)
"""The twelve limb joints by which fits are compared."""

# 68 iBUG landmarks under a left-right reflection of the face.
_FACE_MIRROR = (
    *range(16, -1, -1), *range(26, 16, -1), *range(27, 31), *range(35, 30, -1), 45, 44, 43, 42, 47, 46, 39, 38, 37,
    36, 41, 40, *range(54, 47, -1), *range(59, 54, -1), *range(64, 59, -1), *range(67, 64, -1), 69, 68,
)  # fmt: skip


def mirror() -> np.ndarray:
    """(137,) index of each keypoint's counterpart on the other side of the body; its own inverse."""
    out = np.arange(COUNT)
    for i, name in enumerate(NAMES[: FACE.start]):
        swapped = name.replace("left_", "#").replace("right_", "left_").replace("#", "right_")
        out[i] = INDEX[swapped]
    out[FACE] = FACE.start + np.asarray(_FACE_MIRROR)
    return out


GROUPS: dict[str, tuple[int, ...]] = {
    "limbs": LIMBS,
    "torso": (INDEX["neck"], INDEX["mid_hip"]),
    "head": tuple(INDEX[n] for n in ("nose", "right_eye", "left_eye", "right_ear", "left_ear")),
    "feet": tuple(range(INDEX["left_big_toe"], INDEX["right_heel"] + 1)),
    "hands": tuple(range(LEFT_HAND.start, RIGHT_HAND.stop)),
    "face": tuple(range(FACE.start, FACE.stop)),
}
"""Every keypoint is in exactly one group; the fit weights keypoints by group."""
