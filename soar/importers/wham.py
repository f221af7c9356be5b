"""WHAM: ``wham_output.pkl``, a joblib pickle of a dict from person to ``pose`` (T, 72), ``trans`` and ``frame_ids``.

SMPL's parameters in the axes of the camera; its motion in the world is not used. The camera that it assumes has the
image's diagonal for its focal length.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soar.errors import InputError
from soar.importers.archive import Archive, Known, from_smpl, pinhole, somebody
from soar.importers.files import CURE, array, resolve
from soar.importers.joblib_file import read_joblib


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0."""
    file = resolve(path, "wham_output.pkl")
    tree = read_joblib(file)
    if not isinstance(tree, dict):
        raise InputError(f"{file} holds a {type(tree).__name__}", expected="a dict keyed by person", cure=CURE)
    K = pinhole(known.size, known.focal or float(np.hypot(*known.size)))
    people = []
    for person in tree.values():
        pose = array(person, "pose", (-1, 72), file)
        frames = array(person, "frame_ids", (len(pose),), file).astype(np.int64)
        people.append(from_smpl(frames, pose, array(person, "trans", (len(pose), 3), file), K, known.size))
    return Archive(somebody(people, file))
