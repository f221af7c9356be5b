"""Normals of the clothed person by the networks of ICON or ECON, which the user brings as ONNX files (docs/normals.md).

Xiu et al., ICON: Implicit Clothed humans Obtained from Normals, CVPR 2022; Xiu et al., ECON, CVPR 2023.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from soar.models.onnx import Signature, session
from soar.networks.normal_inputs import fill, nearest_known
from soar.perception.body_normals import body_maps
from soar.perception.brought import brought_file
from soar.perception.normal_maps import GL, Box, Context, Crop, from_network, sampled, seen_from, settled, windowed

SIDE = 512
"""Height and width of the networks' pictures."""

_PICTURE = (1, 3, SIDE, SIDE)

SIGNATURES = {
    f"net{side}": Signature({"image": _PICTURE, f"T_normal_{side}": _PICTURE}, {f"normal_{side}": _PICTURE})
    for side in "FB"
}
"""The files of the folder, without ``.onnx``: front and back, each from the photograph and the body's normals."""


@dataclasses.dataclass(frozen=True)
class IconSettings:
    """Node ``normals`` with the provider ``icon``.

    Attributes:
        provider: ``icon``.
        network: folder with ``netF.onnx`` and ``netB.onnx``.
        margin: side of the square that is looked at, in longer sides of the person's box.
        threshold: mask value in [0, 1] from which a pixel is the person's.
        device: ``auto``, ``cpu`` or ``cuda``.
    """

    provider: Literal["icon"]
    network: str
    margin: float
    threshold: float
    device: Literal["auto", "cpu", "cuda"]


class IconNormals:
    """The provider ``icon``: front and back by two networks, each given the photograph and the posed body's normals.

    Raises:
        ConfigError: no folder is named, or there is no such device.
        ModelFileError: a network is missing, unsafe, or of another signature.
    """

    remarks = ()

    def __init__(self, options: IconSettings, context: Context) -> None:
        folder = brought_file(context.brought, "network", "normals")
        self.options, self.backend = options, context.backend
        self.sessions = [
            session(folder / f"{name}.onnx", context.threads, signature, options.device)
            for name, signature in SIGNATURES.items()
        ]

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; zero outside the mask."""
        inside = crop.alpha >= 255 * self.options.threshold
        height, width = inside.shape
        if not inside.any():
            return np.zeros((height, width, 3), np.float32), np.zeros((height, width, 3), np.float32)
        box = square(inside, self.options.margin)
        mask = sampled(crop.alpha, box, SIDE, SIDE) >= 255 * self.options.threshold
        image = (sampled(crop.rgb, box, SIDE, SIDE) / np.float32(127.5) - 1) * mask[..., None]
        view = windowed(crop.pinhole, box, SIDE, SIDE)
        # The square ends a little beyond the mask's pixels in the crop, which lie between those of the square.
        beyond = nearest_known(mask, np.ones_like(mask))
        place = seen_from((0, 0, width, height), box, SIDE, SIDE)
        found = []
        for network, body in zip(self.sessions, body_maps(crop.vertices, crop.faces, view, self.backend), strict=True):
            names = [node.name for node in network.get_inputs()]
            feed = {name: _planes(image if name == "image" else GL * body) for name in names}
            normals = from_network(network.run(None, feed)[0])
            found.append(settled(sampled(fill(normals, beyond), place, width, height), inside))
        return found[0], found[1]


def square(inside: np.ndarray, margin: float) -> Box:
    """The square about the box of a mask (H, W) that is not empty, ``margin`` times its longer side."""
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    x0, x1, y0, y1 = columns[0], columns[-1] + 1, rows[0], rows[-1] + 1
    half = margin * max(x1 - x0, y1 - y0) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half


def _planes(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) as a batch (1, 3, H, W) float32."""
    return np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)
