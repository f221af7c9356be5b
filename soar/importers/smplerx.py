"""SMPLer-X, and what writes as it does: ``smplx/{frame:05}_{person}.npz``, ``meta/{frame:05}_{person}.json``.

Every person of every frame has a camera of its own, that of the network's crop, in ``meta``; hands are measured from
the mean hand. Frames without a detection have no file, and a person's number is their place in the detector's list.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import numpy as np

from soar.body.parameters import HandSpace, SmplxParameters
from soar.errors import InputError
from soar.importers.archive import Archive, Known, stacked
from soar.importers.files import CURE, array, read_arrays, read_json

_ARRAYS = {
    "global_orient": 3, "body_pose": 63, "left_hand_pose": 45, "right_hand_pose": 45, "jaw_pose": 3, "leye_pose": 3,
    "reye_pose": 3, "betas": -1, "transl": 3,
}  # fmt: skip


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 1, unless there is a frame 0."""
    people: dict[int, dict[int, dict[str, np.ndarray]]] = defaultdict(dict)
    for file in sorted((path / "smplx").glob("*.npz")):
        name = re.fullmatch(r"(\d{1,12})_(\d{1,6})", file.stem)
        if name is None:
            raise InputError(f"{file} is not named as SMPLer-X does", expected="00012_0.npz", cure=CURE)
        meta = path / "meta" / f"{file.stem}.json"
        camera, arrays = read_json(meta), read_arrays(file)
        row = {key: array(arrays, key, (size,), file) for key, size in _ARRAYS.items()}
        row["K"] = np.eye(3)
        row["K"][[0, 1], [0, 1]] = array(camera, "focal", (2,), meta)
        row["K"][:2, 2] = array(camera, "princpt", (2,), meta)
        people[int(name[2])][int(name[1])] = row
    if not people:
        raise InputError(
            f"{path} has no results of SMPLer-X", expected="smplx/*.npz and meta/*.json", cure="correct body.source"
        )
    found = tuple(assembled(stacked(rows, path), known) for _, rows in sorted(people.items()))
    return Archive(found, first=min(1, *(int(person.frames[0]) for person in found)))


def assembled(fields: dict[str, np.ndarray], known: Known) -> SmplxParameters:
    """Parameters of a network of this family, whose camera is that of its crop.

    Args:
        fields: ``frames`` (T,), ``global_orient`` (T, 3), ``body_pose`` (T, 63), ``left_hand_pose`` and
            ``right_hand_pose`` (T, 45) from the mean hand, ``jaw_pose``, ``leye_pose`` and ``reye_pose`` (T, 3),
            ``betas`` (T, B), ``transl`` (T, 3) and ``K`` (T, 3, 3) for the whole image.
        known: image size, and the space of the hands.
    """
    T = len(fields["frames"])
    left, right = _hands(fields, known.hands)
    return SmplxParameters(
        frames=fields["frames"], global_orient=fields["global_orient"],
        body_pose=fields["body_pose"].reshape(T, 21, 3), translation=fields["transl"],
        lever=np.tile(np.eye(3), (T, 1, 1)), frame="camera", betas=fields["betas"], left_hand=left, right_hand=right,
        face=np.stack([fields[key] for key in ("jaw_pose", "leye_pose", "reye_pose")], 1), K=fields["K"],
        size=known.size,
    )  # fmt: skip


def _hands(fields: dict[str, np.ndarray], space: HandSpace | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    if space is None:
        return None, None
    return space.flat(fields["left_hand_pose"], fields["right_hand_pose"], coefficients=False, from_mean=True)
