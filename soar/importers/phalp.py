"""PHALP, the tracker of 4D-Humans: one joblib pickle, ``results/*.pkl``, of a dict keyed by frame.

Each frame lists its people: ``tid``, ``smpl`` with rotation matrices, ``camera`` as a translation in front of a camera
of focal length 5000 for pictures of 256 pixels, ``size`` of the picture. People whom the tracker only remembers
(``tracked_time`` above 0) are left out.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from soar.body.parameters import SmplxParameters, axis_angles
from soar.errors import InputError
from soar.importers.archive import Archive, Known, from_smpl, pinhole, somebody, stacked
from soar.importers.files import CURE, array, entry, rotations
from soar.importers.joblib_file import read_joblib

_FOCAL = 5000 / 256  # per pixel of the longer side


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0."""
    file = _file(path)
    people: dict[int, dict[int, dict[str, np.ndarray]]] = defaultdict(dict)
    tree = read_joblib(file)
    if not isinstance(tree, dict):
        raise InputError(f"{file} holds a {type(tree).__name__}", expected="a dict keyed by frame", cure=CURE)
    for frame in tree.values():
        number, tid = int(array(frame, "time", (), file)), array(frame, "tid", (-1,), file)
        unseen, camera, size = (
            array(frame, key, (len(tid), *more), file)
            for key, more in (("tracked_time", ()), ("camera", (3,)), ("size", (2,)))
        )
        smpl = entry(frame, "smpl", list, file)
        if len(smpl) != len(tid):
            raise InputError(f"{file}: smpl and tid of frame {number} differ in length", cure=CURE)
        for i in np.flatnonzero(unseen == 0):
            row = {"pose": _pose(smpl[i], file), "translation": camera[i], "size": size[i]}
            people[int(tid[i])].setdefault(number, row)
    return Archive(somebody([_person(stacked(rows, file), known) for _, rows in sorted(people.items())], file))


def _file(path: Path) -> Path:
    if path.is_file():
        return path
    found = sorted([*path.glob("*.pkl"), *path.glob("results/*.pkl")])
    if len(found) != 1:
        raise InputError(f"{path} has {len(found)} pickles", expected="one", cure="name the file itself in body.source")
    return found[0]


def _pose(smpl: Any, file: Path) -> np.ndarray:
    """(72,) axis-angle."""
    parts = [rotations(smpl, key, (count, 3, 3), file) for key, count in (("global_orient", 1), ("body_pose", 23))]
    return axis_angles(np.concatenate(parts)).reshape(72)


def _person(fields: dict[str, np.ndarray], known: Known) -> SmplxParameters:
    height, width = (int(side) for side in fields["size"][0])
    K = pinhole((width, height), known.focal or _FOCAL * max(width, height))
    return from_smpl(fields["frames"], fields["pose"], fields["translation"], K, (width, height))
