"""EasyMocap: ``smpl/000012.json``, a list of people with ``id``, ``Rh``, ``Th``, ``poses`` and ``shapes``.

The body turns by ``Rh`` about its origin, not about the pelvis, and then moves by ``Th``. Axes are those of the
calibration, so the sequence must have the same one; with one camera they are the camera's, as are the sequence's.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from soar.body.parameters import SMPL_PELVIS, HandSpace, SmplxParameters, axis_angles, matrices
from soar.errors import InputError
from soar.importers.archive import Archive, Known, somebody, stacked
from soar.importers.files import CURE, array, entry, last_number, read_json

_BODY, _SMPL, _FACE = 66, 72, 9  # numbers of root and body, of SMPL, of jaw and eyes


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are counted from 0."""
    people: dict[int, dict[int, dict[str, np.ndarray]]] = defaultdict(dict)
    folder = path / "smpl" if (path / "smpl").is_dir() else path
    for file in sorted(folder.glob("*.json")):
        frame, found = last_number(file.stem, file), read_json(file)
        for person in found if isinstance(found, list) else entry(found, "annots", list, file):
            row = {key: array(person, key, (size,), file) for key, size in _FIELDS.items()}
            people[entry(person, "id", int, file)][frame] = row | {"poses": _rooted(row["poses"], file)}
    return Archive(somebody([_person(stacked(rows, path), known) for _, rows in sorted(people.items())], path))


_FIELDS = {"Rh": 3, "Th": 3, "poses": -1, "shapes": -1}


def _rooted(poses: np.ndarray, file: Path) -> np.ndarray:
    """Poses that begin with the root: the releases since 2022 leave its three zeros out.

    Of the rest, 69 numbers are SMPL's body and hand joints; an even number is SMPL-H's, body and fingers as PCA
    coefficients; an odd one SMPL-X's, with jaw and eyes behind.
    """
    n = len(poses)
    if n in (_BODY - 3, _SMPL - 3):
        return np.concatenate([np.zeros(3), poses])
    fingers = n - _BODY - _FACE * (n % 2)
    if n != _SMPL and not (0 <= fingers <= 90 and fingers % 2 == 0):
        raise InputError(
            f"{file}: poses is none of EasyMocap's", expected="63, 69, 72, 78 or 87 numbers", got=str(n), cure=CURE
        )
    return poses


def _person(fields: dict[str, np.ndarray], known: Known) -> SmplxParameters:
    poses, turn = fields["poses"], matrices(fields["Rh"])
    T, n = poses.shape
    smplx = n % 2 == 1
    end = n - _FACE if smplx else n
    left, right = _hands(poses[:, _BODY:end], known.hands) if n != _SMPL else (None, None)
    return SmplxParameters(
        frames=fields["frames"], global_orient=axis_angles(turn @ matrices(poses[:, :3])),
        body_pose=poses[:, 3:_BODY].reshape(T, 21, 3), translation=fields["Th"], lever=turn, frame="world",
        betas=fields["shapes"] if smplx else None, left_hand=left, right_hand=right,
        face=poses[:, end:].reshape(T, 3, 3) if smplx else None, rest_pelvis=None if smplx else np.array(SMPL_PELVIS),
    )  # fmt: skip


def _hands(fingers: np.ndarray, space: HandSpace | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Coefficients (T, 2 c), left before right, from the flat hand."""
    if space is None or not fingers.size:
        return None, None
    left, right = np.split(fingers, 2, axis=1)
    return space.flat(left, right, coefficients=True, from_mean=False)
