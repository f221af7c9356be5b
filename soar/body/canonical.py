"""The canonical pose: arms level, elbows straight, straight legs spread."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch

from soar.geometry.rotations import matrix_to_axis_angle

LEG_SPREAD = math.radians(30)  # of each thigh from the vertical

Limb = Sequence[str]
"""Names of three joints: shoulder, elbow and wrist, or hip, knee and ankle."""


def vitruvian(
    joints: np.ndarray,
    names: Sequence[str],
    arms: Sequence[Limb],
    legs: Sequence[Limb],
    up: np.ndarray,
    left: np.ndarray,
) -> np.ndarray:
    """(J, 3) axis-angle, float32, that levels and straightens the arms and spreads the straight legs.

    Args:
        joints: (J, 3) at rest.
        names: of the joints.
        arms, legs: the left one, then the right one.
        up, left: (3,) the body's own axes.
    """
    rotations = np.tile(np.eye(3), (len(names), 1, 1))
    for arm, leg, sign in zip(arms, legs, (1.0, -1.0), strict=True):
        down = math.sin(LEG_SPREAD) * sign * left - math.cos(LEG_SPREAD) * up
        for limb, direction in ((arm, sign * left), (leg, down)):
            turned = np.eye(3)
            for joint, end in itertools.pairwise(limb):
                a, b = names.index(joint), names.index(end)
                local = turned.T @ _shortest(turned @ (joints[b] - joints[a]), direction) @ turned
                rotations[a] = local
                turned = turned @ local
    return matrix_to_axis_angle(torch.from_numpy(rotations)).float().numpy()


def _shortest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of least angle that takes direction ``source`` to unit ``target``; the two are not opposite."""
    a = source / np.linalg.norm(source)
    v, c = np.cross(a, target), float(a @ target)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + K + K @ K / (1 + c)
