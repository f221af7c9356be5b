"""From BlazePose body, hand and face landmarks to the 137 keypoints in OpenPose order."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.body.openpose import BODY
from soar.perception.face import Face
from soar.perception.pose import INDEX

# Keypoints that are not simply the landmark of the same name; () where BlazePose has nothing to offer.
SOURCES: dict[str, tuple[str, ...]] = {
    "neck": ("left_shoulder", "right_shoulder"),
    "mid_hip": ("left_hip", "right_hip"),
    "left_big_toe": ("left_foot_index",),
    "right_big_toe": ("right_foot_index",),
    "left_small_toe": (),
    "right_small_toe": (),
}
JAW = slice(0, 17)
RIGHT_EYE, LEFT_EYE = slice(36, 42), slice(42, 48)

# iBUG point -> vertex of the 468-point mesh; the best of three published lists for each part of the face.
FACE_MESH = np.array(
    [
        162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389,  # jaw
        70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows
        168, 197, 5, 4, 98, 97, 2, 326, 327,  # nose
        33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # eyes
        61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,  # mouth
        78, 82, 13, 312, 308, 317, 14, 87,  # inner lips
    ]
)  # fmt: skip

# Landmarks whose middle each keypoint of BODY_25 is; -1 is the row of zeros appended for keypoints without a source.
_PARENTS = np.array(
    [[INDEX[names[0]], INDEX[names[-1]]] if names else [-1, -1] for names in (SOURCES.get(n, (n,)) for n in BODY)]
)


@dataclasses.dataclass(frozen=True)
class ConfidenceSettings:
    """How far keypoints are trusted beyond what the networks say. Factors and shares in [0, 1]."""

    toe: float
    jaw: float
    disagreement: float
    shared: float


def body_points(points: np.ndarray) -> np.ndarray:
    """Landmarks (..., 33, D) to BODY_25 (..., 25, D): a landmark or the middle of two; zero where there is none."""
    padded = np.concatenate([points, np.zeros_like(points[..., :1, :])], axis=-2)
    return padded[..., _PARENTS, :].mean(-2)


def metric_body(world: np.ndarray) -> np.ndarray:
    """Metric landmarks (T, 33, 3), zero where there are none, to BODY_25 (T, 25, 3); NaN where there are none."""
    known = np.append((world != 0).any(-1), np.zeros((len(world), 1), bool), axis=-1)
    return np.where(known[:, _PARENTS].all(-1)[..., None], body_points(world), np.nan)


def body_confidence(visibility: np.ndarray, toe: float) -> np.ndarray:
    """Visibility (..., 33) to BODY_25 (..., 25): the lesser of the parents; the foot tip counts ``toe`` times."""
    padded = np.concatenate([visibility, np.zeros_like(visibility[..., :1])], axis=-1)
    confidence = padded[..., _PARENTS].min(-1)
    factor = np.array([toe if name.endswith("big_toe") else 1.0 for name in BODY])
    return confidence * factor


def face_keypoints(face: Face | None, jaw: float) -> np.ndarray:
    """(70, 3) x, y, confidence of the face, zeros without one; the jaw line, which no vertex follows, ``jaw`` times."""
    keypoints = np.zeros((70, 3))
    if face is None:
        return keypoints
    keypoints[:68, :2] = face.points[FACE_MESH]
    keypoints[68, :2] = keypoints[RIGHT_EYE, :2].mean(0)
    keypoints[69, :2] = keypoints[LEFT_EYE, :2].mean(0)
    keypoints[:, 2] = face.presence
    keypoints[JAW, 2] *= jaw
    return keypoints


def agreement(distance: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Trust (T, K) in two passes that differ by ``distance`` (T, K): 1 up to ``limit`` (T, 1), then (limit / d)^2."""
    return np.minimum(1.0, limit / np.maximum(distance, 1e-6)) ** 2
