"""``smplx/params.pth`` of the paper's released code: what it fitted to SMPLer-X's estimate, with its cameras.

Hands are measured from the mean hand; ``Ks`` are SMPLer-X's cameras, another one in every frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from soar.importers.archive import Archive, Known
from soar.importers.files import array, read_torch, resolve, rigid
from soar.importers.smplerx import assembled

_PARTS = {
    "global_orient": 3, "body_pose": 63, "left_hand_pose": 45, "right_hand_pose": 45, "jaw_pose": 3, "leye_pose": 3,
    "reye_pose": 3, "betas": 10, "transl": 3,
}  # fmt: skip


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0."""
    file = resolve(path, "params.pth", "smplx/params.pth")
    tree = read_torch(file)
    Ks = array(tree, "Ks", (-1, 3, 3), file)
    T = len(Ks)
    fields = {key: _each(tree, key, size, T, file) for key, size in _PARTS.items()}
    fields |= {"frames": np.arange(T), "K": Ks}
    width, height = array(tree, "img_wh", (2,), file).astype(int).tolist()
    T_cam_from_world = rigid(tree, "w2c", file)
    person = assembled(fields, Known((width, height), known.focal, known.hands))
    return Archive((person.changed(T_cam_from_world[:3, :3], T_cam_from_world[:3, 3]),))


def _each(tree: Any, key: str, size: int, frames: int, file: Path) -> np.ndarray:
    """(T, size): one for every frame, or one for all."""
    value = array(tree, key, (-1, size), file)
    return np.tile(value, (frames, 1)) if len(value) == 1 else array({key: value}, key, (frames, size), file)
