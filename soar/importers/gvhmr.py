"""GVHMR: ``hmr4d_results.pt``, SMPL-X's body of one person in every frame, with the camera's intrinsics.

What it estimates in the camera's axes is read; its motion in a world of its own is not used. There are no hands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soar.body.parameters import SmplxParameters
from soar.importers.archive import Archive, Known
from soar.importers.files import array, entry, read_torch, resolve


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0."""
    file = resolve(path, "hmr4d_results.pt")
    tree = read_torch(file)
    body = entry(tree, "smpl_params_incam", dict, file)
    pose = array(body, "body_pose", (-1, 21, 3), file)
    T = len(pose)
    person = SmplxParameters(
        frames=np.arange(T), global_orient=array(body, "global_orient", (T, 3), file), body_pose=pose,
        translation=array(body, "transl", (T, 3), file), lever=np.tile(np.eye(3), (T, 1, 1)), frame="camera",
        betas=array(body, "betas", (T, -1), file), K=array(tree, "K_fullimg", (T, 3, 3), file), size=known.size,
    )  # fmt: skip
    return Archive((person,))
