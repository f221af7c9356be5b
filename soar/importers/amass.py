"""AMASS: one ``.npz`` of motion capture, in a world whose z axis is up. A motion to be played, not one of any footage.

``poses`` (N, 156) are SMPL-H's: root, body, both hands; (N, 165) are SMPL-X's: root, body, jaw, eyes, both hands. Hands
are rotations from the flat hand. Betas are SMPL-H's, or of a sex, and are not read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soar.body.parameters import SMPL_PELVIS, SmplxParameters
from soar.errors import InputError
from soar.importers.archive import Archive, Known
from soar.importers.files import CURE, array, read_arrays

_SMPLH, _SMPLX = 156, 165


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0, at the capture's own rate."""
    arrays = read_arrays(path)
    shape = arrays["poses"].shape if "poses" in arrays else ()
    if len(shape) != 2 or shape[1] not in (_SMPLH, _SMPLX):
        raise InputError(
            f"{path}: poses are none of AMASS's", expected=f"(N, {_SMPLH}) or (N, {_SMPLX})", got=str(shape), cure=CURE
        )
    T, n = shape
    poses, smplx = array(arrays, "poses", shape, path), n == _SMPLX
    hands = poses[:, n - 90 :].reshape(T, 2, 15, 3)
    person = SmplxParameters(
        frames=np.arange(T), global_orient=poses[:, :3], body_pose=poses[:, 3:66].reshape(T, 21, 3),
        translation=array(arrays, "trans", (T, 3), path), lever=np.tile(np.eye(3), (T, 1, 1)), frame="world",
        left_hand=hands[:, 0], right_hand=hands[:, 1], face=poses[:, 66:75].reshape(T, 3, 3) if smplx else None,
        rest_pelvis=None if smplx else np.array(SMPL_PELVIS),
    )  # fmt: skip
    return Archive((person,))
