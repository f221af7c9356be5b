"""The files of SMPL-X that users bring (``SMPLX_NEUTRAL.npz`` or ``.pkl``), read without running what is in them.

The model is licensed by its makers and never comes with this project. V = 10475 vertices, F = 20908 triangles, 55
joints; metres, y up, in T-pose, the face towards +z and the left hand towards +x, the pelvis about 0.35 m below the
origin. Version 1.0 has 10 shape and 10 expression components in ``shapedirs``, version 1.1 has 300 and 100.
"""

from __future__ import annotations

import dataclasses
import os
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from soar.errors import ModelFileError
from soar.models.pickles import unpickle_arrays

VERTICES, FACES = 10475, 20908
COMPONENTS = {20: 10, 400: 300}
"""Components in ``shapedirs`` -> how many of them, the first, are shape; the rest are expression."""

JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "jaw", "left_eye_smplhf",
    "right_eye_smplhf",
    *(f"{side}_{finger}{k}" for side in ("left", "right") for finger in ("index", "middle", "pinky", "ring", "thumb")
      for k in (1, 2, 3)),
)  # fmt: skip
"""Official names of the 55 joints, in order."""

PARENTS = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
    20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38,
    21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50, 21, 52, 53,
)  # fmt: skip

_CURE = (
    "bring the file SMPLX_NEUTRAL.npz, SMPLX_FEMALE.npz or SMPLX_MALE.npz of SMPL-X 1.1 or 1.0 as it is downloaded; "
    "those of SMPL, SMPL-H, MANO and FLAME are other models"
)
_LARGEST = 2 << 30  # bytes; a pickle of the model has 0.5 GB
_TOLERANCE = 1e-3  # of sums that are to be one

_J, _V, _F = len(JOINTS), VERTICES, FACES
_REAL: dict[str, tuple[int, ...] | None] = {
    "v_template": (_V, 3), "shapedirs": None, "posedirs": (_V, 3, 9 * (_J - 1)), "J_regressor": (_J, _V),
    "weights": (_V, _J), "hands_componentsl": (45, 45), "hands_componentsr": (45, 45), "hands_meanl": (45,),
    "hands_meanr": (45,), "lmk_bary_coords": (51, 3), "dynamic_lmk_bary_coords": (79, 17, 3),
}  # fmt: skip
_WHOLE: dict[str, tuple[int, ...]] = {
    "f": (_F, 3), "kintree_table": (2, _J), "lmk_faces_idx": (51,), "dynamic_lmk_faces_idx": (79, 17),
}  # fmt: skip
_SHAPEDIRS = tuple((_V, 3, count) for count in COMPONENTS)


@dataclasses.dataclass(frozen=True)
class SmplxFile:
    """What a model file holds, in the precision of the file; every array is finite and of the shape said here.

    Attributes:
        v_template: (V, 3) mean vertices, metres.
        shapedirs: (V, 3, 10 or 300) displacement per standard deviation of a shape component.
        exprdirs: (V, 3, 10 or 100) displacement per standard deviation of an expression component.
        posedirs: (V, 3, 486) displacement per entry of the rotations of joints 1 to 54, less the identity.
        J_regressor: (55, V) joints from shaped vertices.
        weights: (V, 55) skin weights; rows sum to one.
        faces: (F, 3) int64.
        hand_components: (2, 45, 45) rows are the principal components of the left and of the right hand's pose.
        hand_mean: (2, 45) axis-angle of the 15 joints of the mean left and right hand, radians.
        landmark_faces, landmark_barycentrics: (51,) int64 and (51, 3): the landmarks 17 to 67 of iBUG's 68.
        contour_faces, contour_barycentrics: (79, 17) int64 and (79, 17, 3): landmarks 0 to 16 as the head is turned.
    """

    v_template: np.ndarray
    shapedirs: np.ndarray
    exprdirs: np.ndarray
    posedirs: np.ndarray
    J_regressor: np.ndarray
    weights: np.ndarray
    faces: np.ndarray
    hand_components: np.ndarray
    hand_mean: np.ndarray
    landmark_faces: np.ndarray
    landmark_barycentrics: np.ndarray
    contour_faces: np.ndarray
    contour_barycentrics: np.ndarray


def read_smplx(path: str | os.PathLike[str]) -> SmplxFile:
    """Read a model file.

    Shapes and types are looked at before an array is read, so a file that promises more than the model has is refused
    without the memory for it.

    Raises:
        ModelFileError: the file is missing, damaged, would run code, or is not of SMPL-X; says which array is wrong.
    """
    path = Path(path)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "nothing"
        raise ModelFileError(f"{path} is no SMPL-X model file", expected="a file", got=got, cure=_CURE)
    readers = {".npz": _from_npz, ".pkl": _from_pickle}
    if path.suffix not in readers:
        raise ModelFileError(
            f"{path} is no SMPL-X model file", expected=" or ".join(readers), got=path.suffix, cure=_CURE
        )
    arrays = readers[path.suffix](path)
    for key, value in arrays.items():
        arrays[key] = np.asarray(value, value.dtype.newbyteorder("="))
        if not np.isfinite(value).all():
            raise _bad(path, f"{key} holds NaN or infinity", "finite numbers", "not finite")
    # The root's parent is -1, in some files as the largest number of its type.
    arrays["kintree_table"] = arrays["kintree_table"][0, 1:]
    whole = {key: _whole(path, key, arrays[key]) for key in _WHOLE}
    _check_tree(path, whole["kintree_table"].tolist())
    _check_range(path, "f", whole["f"], _V)
    for key in ("lmk_faces_idx", "dynamic_lmk_faces_idx"):
        _check_range(path, key, whole[key], _F)
    for key in ("weights", "lmk_bary_coords", "dynamic_lmk_bary_coords"):
        off = float(np.abs(arrays[key].sum(-1) - 1).max())
        if off > _TOLERANCE:
            raise _bad(path, f"{key} do not sum to one", "rows that sum to 1", f"off by {off:.3g}")
    shapes = COMPONENTS[arrays["shapedirs"].shape[-1]]
    return SmplxFile(
        v_template=arrays["v_template"],
        shapedirs=arrays["shapedirs"][..., :shapes],
        exprdirs=arrays["shapedirs"][..., shapes:],
        posedirs=arrays["posedirs"],
        J_regressor=arrays["J_regressor"],
        weights=arrays["weights"],
        faces=whole["f"],
        hand_components=np.stack([arrays["hands_componentsl"], arrays["hands_componentsr"]]),
        hand_mean=np.stack([arrays["hands_meanl"], arrays["hands_meanr"]]),
        landmark_faces=whole["lmk_faces_idx"],
        landmark_barycentrics=arrays["lmk_bary_coords"],
        contour_faces=whole["dynamic_lmk_faces_idx"],
        contour_barycentrics=arrays["dynamic_lmk_bary_coords"],
    )


def _from_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the model; the others, some of which are pickles, are not looked at."""
    try:
        with zipfile.ZipFile(path) as archive:
            _check_names(path, [name.removesuffix(".npy") for name in archive.namelist()])
            return {key: _member(path, archive, key) for key in (*_REAL, *_WHOLE)}
    except (
        OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, SyntaxError, tokenize.TokenError,
        zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise ModelFileError(f"{path} cannot be read: {error}", cure=f"download it again, and {_CURE}") from error


def _member(path: Path, archive: zipfile.ZipFile, key: str) -> np.ndarray:
    if archive.getinfo(f"{key}.npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{key} is compressed in a way that npz files are not")
    with archive.open(f"{key}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):  # whose headers are short
            raise ValueError(f"{key} is of version {version} of its format")
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    _check_form(path, key, dtype, shape)
    with archive.open(f"{key}.npy") as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _from_pickle(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the model from a pickle by Python 2 or 3; sparse ones made dense."""
    if (size := path.stat().st_size) > _LARGEST:
        raise _bad(path, "is too large", f"at most {_LARGEST} bytes", str(size))
    tree = unpickle_arrays(path.read_bytes(), str(path), f"{_CURE}; a pickle holds arrays of numpy and scipy only")
    _check_names(path, list(tree))
    arrays: dict[str, np.ndarray] = {}
    for key in (*_REAL, *_WHOLE):
        value: Any = tree[key]
        if not (hasattr(value, "dtype") and hasattr(value, "shape")):
            raise _bad(path, f"{key} is no array", "an array", type(value).__name__)
        _check_form(path, key, value.dtype, value.shape)
        arrays[key] = value if isinstance(value, np.ndarray) else value.toarray()
    return arrays


def _check_names(path: Path, names: list[str]) -> None:
    missing = [key for key in (*_REAL, *_WHOLE) if key not in names]
    if missing:
        raise _bad(path, "lacks arrays of SMPL-X", ", ".join((*_REAL, *_WHOLE)), "no " + ", ".join(missing))


def _check_form(path: Path, key: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    expected = _SHAPEDIRS if key == "shapedirs" else (_REAL.get(key) or _WHOLE[key],)
    if tuple(shape) not in expected:
        raise _bad(path, f"{key} has the wrong shape", " or ".join(map(str, expected)), str(tuple(shape)))
    kinds = "f" if key in _REAL else "iuf"
    if dtype.kind not in kinds or dtype.itemsize > 8:
        raise _bad(
            path,
            f"{key} is not of numbers",
            "floats of 64 bits at most" + ", or whole numbers" * (kinds != "f"),
            str(dtype),
        )


def _whole(path: Path, key: str, value: np.ndarray) -> np.ndarray:
    """Indices as int64. Of which type they are differs between releases."""
    out = value.astype(np.int64)
    if not (out == value).all():
        raise _bad(path, f"{key} holds no indices", "whole numbers", str(value.dtype))
    return out


def _check_tree(path: Path, parents: list[int]) -> None:
    """Compare the parents of joints 1 to 54 with the official ones."""
    for joint, (expected, got) in enumerate(zip(PARENTS[1:], parents, strict=True), start=1):
        if got != expected:
            raise _bad(path, f"kintree_table: joint {joint} hangs elsewhere", f"parent {expected}", f"parent {got}")


def _check_range(path: Path, key: str, indices: np.ndarray, count: int) -> None:
    low, high = int(indices.min()), int(indices.max())
    if low < 0 or high >= count:
        raise _bad(path, f"{key} is out of range", f"0 to {count - 1}", f"{low} to {high}")


def _bad(path: Path, what: str, expected: str, got: str) -> ModelFileError:
    return ModelFileError(f"SMPL-X model {path}: {what}", expected=expected, got=got, cure=_CURE)
