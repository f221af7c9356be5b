"""Files of the form of SMPL-X's, of random content or of the shape of a person; none of it is the makers' own.

The random content is numpy's legacy stream, which never changes, so ``data/smplx_golden.npz`` belongs to it for good.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from soar.body.smplx_file import FACES, JOINTS, PARENTS, VERTICES

SEED = 20
"""Of the file that the golden numbers were computed with."""


def arrays(components: int, seed: int = SEED, dtype: type = np.float64) -> dict[str, np.ndarray]:
    """The numeric arrays of a model file: 20 ``components`` as in version 1.0, or 400 as in 1.1."""
    rng = np.random.RandomState(seed)

    def uniform(low: float, high: float, *shape: int) -> np.ndarray:
        return low + (high - low) * rng.random_sample(shape)

    weights = uniform(0, 1, VERTICES, len(JOINTS)) ** 20
    regressor = uniform(0, 1, len(JOINTS), VERTICES) ** 1000
    faces = rng.randint(VERTICES, size=(FACES, 1)) + rng.permutation(VERTICES - 1)[:3] + 1
    barycentrics = [uniform(0, 1, *shape) for shape in ((51, 3), (79, 17, 3))]
    found = {
        "v_template": uniform(-1, 1, VERTICES, 3),
        "f": (faces % VERTICES).astype(np.uint32),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": kintree(),
        "hands_componentsl": uniform(-0.3, 0.3, 45, 45),
        "hands_componentsr": uniform(-0.3, 0.3, 45, 45),
        "hands_meanl": uniform(-0.5, 0.5, 45),
        "hands_meanr": uniform(-0.5, 0.5, 45),
        "lmk_faces_idx": rng.randint(FACES, size=51),
        "lmk_bary_coords": barycentrics[0] / barycentrics[0].sum(-1, keepdims=True),
        "dynamic_lmk_faces_idx": rng.randint(FACES, size=(79, 17)),
        "dynamic_lmk_bary_coords": barycentrics[1] / barycentrics[1].sum(-1, keepdims=True),
        "shapedirs": uniform(-0.02, 0.02, VERTICES, 3, components),
        "posedirs": uniform(-0.003, 0.003, VERTICES, 3, 9 * (len(JOINTS) - 1)),
    }
    return {key: value.astype(dtype) if value.dtype == np.float64 else value for key, value in found.items()}


def kintree() -> np.ndarray:
    """(2, 55) uint32 parents and joints; the root's parent is -1 as that type writes it."""
    return np.array([PARENTS, range(len(JOINTS))]).astype(np.int64).astype(np.uint32)


def write(path: Path, content: dict[str, Any]) -> Path:
    """An ``.npz`` with what else such files hold, pickled objects among it."""
    objects = {name: np.array({"pelvis": 0}, object) for name in ("joint2num", "part2num")}
    others = {"vt": np.zeros((11313, 2)), "hands_coeffsl": np.zeros((3, 45)), "allow_pickle": np.array(True)}
    np.savez(path, **content, **objects, **others)
    return path


# --- poses ------------------------------------------------------------------------------------------------------------

FRAMES = 3
SUBSET = slice(0, VERTICES, 499)
"""Vertices that are compared."""

CASES = tuple(
    (components, hands, flat) for components in (20, 400) for hands in (6, 12, 45, "full") for flat in (False, True)
)
BETAS, EXPRESSION = {20: 10, 400: 16}, {20: 10, 400: 50}


def parameters(components: int, hands: int | str) -> dict[str, np.ndarray]:
    """Arguments of one call of the official package, float64; one head looks ahead, two are turned to either side."""
    rng = np.random.RandomState(components + (0 if hands == "full" else int(hands)))
    size = 45 if hands == "full" else int(hands)
    widths = {
        "betas": BETAS[components], "expression": EXPRESSION[components], "body_pose": 63, "jaw_pose": 3,
        "leye_pose": 3, "reye_pose": 3, "left_hand_pose": size, "right_hand_pose": size, "transl": 3,
    }  # fmt: skip
    drawn = {name: rng.uniform(-0.6, 0.6, (FRAMES, width)) for name, width in widths.items()}
    turned = np.array([[0.0, 0.04, 0.0], [0.2, 0.7, -0.1], [-0.3, -1.4, 0.4]])
    return drawn | {"global_orient": turned}
