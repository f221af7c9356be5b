"""ROMP's parameters as InstantAvatar, GART and GaussianAvatar exchange them: ``poses.npz`` beside ``cameras.npz``.

SMPL's parameters with the translation added last, in the axes of ``extrinsic``. Without ``cameras.npz`` the camera is
the one that ROMP assumes: a field of view of 60 degrees along the longer side.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soar.errors import InputError
from soar.importers.archive import Archive, Known, from_smpl, pinhole
from soar.importers.files import CURE, array, read_arrays, resolve, rigid

_HALF_FOV = np.radians(30)


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0; refined poses come before raw ones."""
    file = resolve(path, "poses_optimized.npz", "poses.npz")
    arrays = read_arrays(file)
    if "thetas" in arrays:
        pose = array(arrays, "thetas", (-1, 72), file)
    else:
        root, body = array(arrays, "global_orient", (-1, 3), file), array(arrays, "body_pose", (-1, 69), file)
        if len(root) != len(body):
            raise InputError(
                f"{file}: global_orient and body_pose differ in frames", got=f"{len(root)}, {len(body)}", cure=CURE
            )
        pose = np.concatenate([root, body], 1)
    translation = array(arrays, "transl", (len(pose), 3), file)
    K, T_cam_from_world, size = _camera(file.with_name("cameras.npz"), known)
    person = from_smpl(np.arange(len(pose)), pose, translation, K, size)
    return Archive((person.changed(T_cam_from_world[:3, :3], T_cam_from_world[:3, 3]),))


def _camera(file: Path, known: Known) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Intrinsics (3, 3), pose (4, 4) and image size."""
    if not file.is_file():
        focal = known.focal or max(known.size) / 2 / np.tan(_HALF_FOV)
        return pinhole(known.size, focal), np.eye(4), known.size
    arrays = read_arrays(file)
    width, height = (int(array(arrays, key, (), file)) for key in ("width", "height"))
    return array(arrays, "intrinsic", (3, 3), file), rigid(arrays, "extrinsic", file), (width, height)
