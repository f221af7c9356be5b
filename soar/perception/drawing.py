"""Pictures of what was found: the skeleton coloured by side, so that swapped sides are seen at a glance, and people."""

from __future__ import annotations

import cv2
import numpy as np

from soar.body.openpose import FACE, INDEX, LEFT_HAND, RIGHT_HAND
from soar.perception.roi import Roi

LEFT_COLOUR, RIGHT_COLOUR, MIDDLE_COLOUR = (40, 150, 255), (255, 120, 30), (250, 240, 90)  # blue, orange, yellow
PERSON_COLOUR = (230, 40, 60)  # red

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


def draw_person(image: np.ndarray, roi: Roi, width: float, text: str, broken: bool = False) -> np.ndarray:
    """Draw a box of a person's size in their region over a frame, a cross at its centre and a line of text beside it.

    Args:
        image: (H, W, 3) uint8 RGB.
        roi: the region.
        width: of a line, pixels; letters are eight times as high.
        text: may be empty.
        broken: draw the corners of the box only, as of somebody who is not seen.
    """
    canvas, thick = image.copy(), max(1, round(width))
    ends = np.array([0.0, 0.15, 0.85, 1.0] if broken else [0.0, 0.5, 0.5, 1.0])
    corners = np.array([[0.3, 0.1], [0.7, 0.1], [0.7, 0.9], [0.3, 0.9]])
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = roi.to_image(a + ends[:, None] * (b - a), 1.0).round().astype(int)
        for start, end in (points[:2], points[2:]):
            cv2.line(canvas, start.tolist(), end.tolist(), PERSON_COLOUR, thick, cv2.LINE_AA)
    x, y = round(roi.cx), round(roi.cy)
    cv2.drawMarker(canvas, (x, y), PERSON_COLOUR, cv2.MARKER_CROSS, 6 * thick, thick, cv2.LINE_AA)
    place = (x + 4 * thick, y - 4 * thick)
    cv2.putText(canvas, text, place, PERSON_COLOUR, cv2.FontFace("sans"), 8 * thick, 700)
    return canvas
