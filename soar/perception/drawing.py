"""The skeleton drawn over a frame, coloured by side, so that a mirrored limb or swapped sides are seen at a glance."""

from __future__ import annotations

import cv2
import numpy as np

from soar.body.openpose import FACE, INDEX, LEFT_HAND, RIGHT_HAND

LEFT_COLOUR, RIGHT_COLOUR, MIDDLE_COLOUR = (40, 150, 255), (255, 120, 30), (250, 240, 90)  # blue, orange, yellow

_BODY = (
    "nose neck", "neck mid_hip",
    "neck left_shoulder", "left_shoulder left_elbow", "left_elbow left_wrist", "mid_hip left_hip",
    "left_hip left_knee", "left_knee left_ankle", "left_ankle left_heel", "left_ankle left_big_toe",
    "nose left_eye", "left_eye left_ear",
    "neck right_shoulder", "right_shoulder right_elbow", "right_elbow right_wrist", "mid_hip right_hip",
    "right_hip right_knee", "right_knee right_ankle", "right_ankle right_heel", "right_ankle right_big_toe",
    "nose right_eye", "right_eye right_ear",
)  # fmt: skip
_FINGERS = [
    (0 if joint == 1 else joint - 1 + 4 * finger, joint + 4 * finger) for finger in range(5) for joint in range(1, 5)
]


def _colour(name: str) -> tuple[int, int, int]:
    return LEFT_COLOUR if "left" in name else RIGHT_COLOUR if "right" in name else MIDDLE_COLOUR


def _lines() -> list[tuple[int, int, tuple[int, int, int], float]]:
    """Start, end, colour and relative width of every line of the drawing."""
    lines = [(*(INDEX[n] for n in bone.split()), _colour(bone), 1.0) for bone in _BODY]
    for hand, colour in ((LEFT_HAND, LEFT_COLOUR), (RIGHT_HAND, RIGHT_COLOUR)):
        lines += [(hand.start + a, hand.start + b, colour, 0.4) for a, b in _FINGERS]
    return lines


def draw_skeleton(image: np.ndarray, keypoints: np.ndarray, width: float) -> np.ndarray:
    """Draw 137 keypoints over a frame; confidence is opacity, the subject's left is blue and right is orange.

    Args:
        image: (H, W, 3) uint8 RGB.
        keypoints: (137, 3) x, y in pixels and confidence in [0, 1].
        width: of a limb, pixels.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    canvas, opacity = image.copy(), np.zeros(image.shape[:2], np.float32)
    points = [tuple(round(float(v)) for v in p[:2]) for p in keypoints]
    for a, b, colour, scale in _lines():
        trust = float(min(keypoints[a, 2], keypoints[b, 2]))
        if trust > 0:
            thick = max(1, round(width * scale))
            cv2.line(canvas, points[a], points[b], colour, thick, cv2.LINE_AA)
            cv2.line(opacity, points[a], points[b], trust, thick)
    for i in range(FACE.start, FACE.stop):
        if keypoints[i, 2] > 0:
            radius = max(1, round(width * 0.2))
            cv2.circle(canvas, points[i], radius, MIDDLE_COLOUR, -1, cv2.LINE_AA)
            cv2.circle(opacity, points[i], radius, float(keypoints[i, 2]), -1)
    blend = opacity[..., None]
    return np.round(blend * canvas + (1 - blend) * image).astype(np.uint8)
