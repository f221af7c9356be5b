"""From the networks' answers in every frame to one consistent record of keypoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from soar.body import openpose
from soar.perception import mapping, swaps
from soar.perception.face import Face
from soar.perception.keypoints import Keypoints
from soar.perception.pose import Pose
from soar.perception.roi import Roi


@dataclasses.dataclass(frozen=True)
class Observation:
    """All estimates of one frame: two passes of the body, (21, 3) hands, and the face if one was seen."""

    pose: Pose
    mirrored: Pose
    left_hand: np.ndarray
    right_hand: np.ndarray
    face: Face | None

    @property
    def presence(self) -> float:
        """Probability in [0, 1] that the region showed a person."""
        return self.pose.presence

    @property
    def points(self) -> np.ndarray:
        """(33, 2) image landmarks of the direct pass, pixels."""
        return self.pose.points

    @property
    def next_roi(self) -> Roi:
        """Where to look in a neighbouring frame, turned with the whole lean of the body."""
        return self.pose.next_roi


def _stacked(poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (F, 33, 2), metric landmarks (F, 33, 3) and visibility (F, 33)."""
    return (
        np.array([p.points for p in poses]),
        np.array([p.world for p in poses]),
        np.array([p.visibility for p in poses]),
    )


def assemble(
    observations: Sequence[Observation | None],
    presence: Sequence[float],
    swap_settings: swaps.SwapSettings,
    confidence: mapping.ConfidenceSettings,
) -> tuple[Keypoints, np.ndarray]:
    """Undo left/right exchanges, average the two passes where they agree, map to OpenPose order, set confidences.

    Args:
        observations: (T,) estimates, None where the subject was not found; at least one.
        presence: (T,) in [0, 1].
        swap_settings: weights of the left/right consistency.
        confidence: factors on the confidences.

    Returns:
        the record, and (T, 3) bool, whether head, arms and legs carry the other side's name than in the direct pass.
    """
    count = len(observations)
    found = [t for t, o in enumerate(observations) if o is not None]
    seen = [o for o in observations if o is not None]
    passes = np.array([[o.pose.points for o in seen], [o.mirrored.points for o in seen]]).reshape(2, -1, 33, 2)
    depth = np.array([[o.pose.world[:, 2] for o in seen], [o.mirrored.world[:, 2] for o in seen]])
    source, sets = swaps.resolve(passes, depth, swap_settings)
    chosen = [o.mirrored if s else o.pose for o, s in zip(seen, source, strict=True)]
    second = [o.pose if s else o.mirrored for o, s in zip(seen, source, strict=True)]
    points, metres, visibility = (swaps.relabelled(a, sets) for a in _stacked(chosen))
    other_points, other_metres, _ = _stacked(second)
    other_sets = swaps.exchanged(points, other_points)
    other_points, other_metres = (swaps.relabelled(a, other_sets) for a in (other_points, other_metres))

    apart = np.linalg.norm(mapping.body_points(points - other_points), axis=-1)
    limit = confidence.disagreement * np.linalg.norm(swaps.torso(points), axis=-1, keepdims=True)
    trust = mapping.body_confidence(visibility, confidence.toe) * mapping.agreement(apart, limit)
    # The mean of two passes is steadier than either; where they differ the second one counts less.
    share = mapping.agreement(np.linalg.norm(points - other_points, axis=-1), limit)[..., None] / 2
    points, metres = (a + share * (b - a) for a, b in ((points, other_points), (metres, other_metres)))
    body = mapping.body_points(points)

    swapped = np.zeros((count, len(swaps.SETS)), bool)
    swapped[found] = swaps.exchanged(points, passes[0])
    world, roi, disagreement = np.zeros((count, 33, 3)), np.zeros((count, 4)), np.zeros((count, len(openpose.BODY)))
    world[found], disagreement[found] = metres, apart
    # Masks want the region of this very frame, turned with the whole lean.
    regions = [o.next_roi if o.next_roi.usable else o.pose.roi for o in seen]
    roi[found] = [dataclasses.astuple(r) for r in regions]
    keypoints = np.zeros((count, openpose.COUNT, 3))
    keypoints[found, : len(openpose.BODY)] = np.concatenate([body, trust[..., None]], axis=-1)
    head, arms, _ = swapped.T
    for t, o in zip(found, seen, strict=True):
        hands = (o.right_hand, o.left_hand) if arms[t] else (o.left_hand, o.right_hand)
        keypoints[t, openpose.LEFT_HAND], keypoints[t, openpose.RIGHT_HAND] = hands
        # With the eyes exchanged the face was looked for upside down; whatever was found there is not a face.
        keypoints[t, openpose.FACE] = mapping.face_keypoints(None if head[t] else o.face, confidence.jaw)
    return Keypoints(*(np.asarray(v, np.float32) for v in (keypoints, world, roi, presence, disagreement))), swapped
