"""What the normal network is given and gives back: one assembly for training and for use.

Everything is in the convention of this project (camera space, x right, y down, z forward; n_z < 0 in front). Names of
inputs and outputs follow ICON's normal network (Xiu et al., ICON, 2022), whose axes y and z point the other way.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from soar.models.onnx import Signature

INPUTS = {"image": 3, "mask": 1, "T_normal_F": 3, "T_normal_B": 3, "body_mask": 1}
"""Planes of each input, in order: colours in [-1, 1] times the mask; the soft mask in [0, 1]; the body's normals, front
and back, filled outward within the mask; 1 where the body itself is."""

OUTPUTS = {"nml_F": 3, "nml_B": 3}
"""Planes of each output: unit normals of what the camera sees and of the far side, clothes and hair included."""

SIGNATURE = Signature(
    {name: (None, planes, None, None) for name, planes in INPUTS.items()},
    {name: (None, planes, None, None) for name, planes in OUTPUTS.items()},
)


def assemble(rgb: np.ndarray, mask: np.ndarray, front: np.ndarray, back: np.ndarray) -> dict[str, np.ndarray]:
    """The network's inputs for one picture.

    Args:
        rgb: (H, W, 3) uint8 picture.
        mask: (H, W) uint8 soft mask of the person.
        front, back: (H, W, 3) float32 unit normals of the body, zero where it is not.

    Returns:
        (planes, H, W) float32 arrays named as :data:`INPUTS`.
    """
    alpha = mask.astype(np.float32) / 255.0
    body = covered(front)
    nearest = nearest_known(body, mask > 0)
    planes = {
        "image": (rgb.astype(np.float32) / 127.5 - 1.0) * alpha[..., None],
        "mask": alpha[..., None],
        "T_normal_F": fill(front, nearest),
        "T_normal_B": fill(back, nearest),
        "body_mask": body[..., None],
    }
    return {name: np.ascontiguousarray(value.transpose(2, 0, 1), np.float32) for name, value in planes.items()}


def batch(samples: list[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Stack samples of one size: (planes, H, W) each becomes (N, planes, H, W)."""
    return {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}


def mirrored(planes: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Inputs or outputs (..., planes, H, W) of the mirrored picture; the x of normals changes sign."""
    out = {name: value[..., ::-1].copy() for name, value in planes.items()}
    for name in out.keys() & {"T_normal_F", "T_normal_B", *OUTPUTS}:
        out[name][..., 0, :, :] *= -1
    return out


def covered(normals: np.ndarray) -> np.ndarray:
    """(H, W) bool: where (H, W, 3) normals are not zero. Written out: reducing a short axis is slow."""
    return (normals[..., 0] != 0) | (normals[..., 1] != 0) | (normals[..., 2] != 0)


def nearest_known(known: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """For the wanted pixels that are not known, where the nearest known one is.

    Args:
        known, wanted: (H, W) bool.

    Returns:
        flat indices (P,) of the pixels to fill and (P,) of those to fill them from; None where nothing is known.
    """
    if not known.any():
        return None
    _, label = cv2.distanceTransformWithLabels(
        np.uint8(~known), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.zeros(label.max() + 1, np.int64)
    source[label[known]] = np.flatnonzero(known)
    target = np.flatnonzero(wanted & ~known)
    return target, source[label.ravel()[target]]


def fill(values: np.ndarray, nearest: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """A copy of (H, W, C) values with the pixels that :func:`nearest_known` found filled; unchanged for None."""
    out = values.copy()
    if nearest is not None:
        target, source = nearest
        flat = out.reshape(-1, out.shape[-1])
        flat[target] = flat[source]
    return out
