"""SMPLify-X: ``results/<image>/000.pkl``, one pickle per person of every image, in the axes of its camera.

The files do not say the focal length; the tool's own is 5000 pixels. A pose of 32 numbers is a code of VPoser, which
only VPoser's own weights turn into angles: it is refused. Hands of fewer than 45 numbers are PCA coefficients; all are
measured from the mean hand.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from soar.body.parameters import HandSpace, SmplxParameters
from soar.errors import InputError
from soar.importers.archive import Archive, Known, pinhole, somebody, stacked
from soar.importers.files import CURE, array, last_number, read_pickle, rotations

_FOCAL = 5000.0  # pixels, the default of its configuration
_CODE, _HAND = 32, 45


def read(path: Path, known: Known) -> Archive:
    """See :class:`~soar.importers.archive.Reader`. Frames are numbered by the last number in the images' names."""
    people: dict[int, dict[int, dict[str, np.ndarray]]] = defaultdict(dict)
    folder = path / "results" if (path / "results").is_dir() else path
    for file in sorted(folder.glob("*/*.pkl")):
        row, tree = {}, read_pickle(file)
        for key, size in (("global_orient", 3), ("betas", -1), ("camera_translation", 3), ("body_pose", -1)):
            row[key] = array(tree, key, (size,), file)
        if len(row["body_pose"]) == _CODE:
            raise InputError(
                f"{file}: body_pose is a code of VPoser, not a pose", expected="63 numbers", got=f"{_CODE}",
                cure="decode it with VPoser and write 63 numbers, or run SMPLify-X with use_vposer: False",
            )  # fmt: skip
        row["body_pose"] = array(row, "body_pose", (21, 3), file)
        row["camera_rotation"] = rotations(tree, "camera_rotation", (3, 3), file)
        row["face"] = np.stack([array(tree, key, (3,), file) for key in ("jaw_pose", "leye_pose", "reye_pose")])
        if known.hands is not None:
            left, right = (array(tree, f"{side}_hand_pose", (1, -1), file) for side in ("left", "right"))
            row["left"], row["right"] = _hands(left, right, known.hands, file)
        people[last_number(file.stem, file)][last_number(file.parent.name, file)] = row
    return Archive(somebody([_person(stacked(rows, path), known) for _, rows in sorted(people.items())], path))


def _person(fields: dict[str, np.ndarray], known: Known) -> SmplxParameters:
    T = len(fields["frames"])
    K = pinhole(known.size, known.focal or _FOCAL)
    person = SmplxParameters(
        frames=fields["frames"], global_orient=fields["global_orient"], body_pose=fields["body_pose"],
        translation=np.zeros((T, 3)), lever=np.tile(np.eye(3), (T, 1, 1)), frame="camera", betas=fields["betas"],
        left_hand=fields.get("left"), right_hand=fields.get("right"), face=fields["face"], K=np.tile(K, (T, 1, 1)),
        size=known.size,
    )  # fmt: skip
    return person.changed(fields["camera_rotation"], fields["camera_translation"])


def _hands(left: np.ndarray, right: np.ndarray, space: HandSpace, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """(15, 3) each, of (1, n)."""
    n = left.shape[1]
    if right.shape[1] != n or not 0 < n <= _HAND:
        raise InputError(
            f"{file}: the hands are malformed", expected=f"twice 1 to {_HAND} numbers", got=f"{n}, {right.shape[1]}",
            cure=CURE,
        )  # fmt: skip
    flat = space.flat(left, right, coefficients=n < _HAND, from_mean=True)
    return flat[0][0], flat[1][0]
