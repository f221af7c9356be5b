"""Normals of the clothed person by a network that sees the photograph and the posed body."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from torch import Tensor

from soar.models.onnx import session
from soar.networks import DATA
from soar.networks.normal_inputs import OUTPUTS, SIGNATURE, assemble, batch, fill, mirrored, nearest_known
from soar.perception.body_normals import body_maps
from soar.raster import Pinhole, RasterSettings

BUNDLED = DATA / "normals.onnx"
"""The network that comes with the package; ``docs/networks.md`` is its model card."""


@dataclasses.dataclass(frozen=True)
class NormalModelSettings:
    """Node ``normals`` with the provider ``mini``.

    Attributes:
        provider: ``mini``.
        network: an ONNX file of the same signature, or None for the bundled one.
        long_side: a crop is worked on at such a size that its long side has at most this many pixels.
        multiple: height and width the network needs are multiples of this, pixels.
        threshold: mask value in [0, 1] from which a pixel gets normals.
        mirror: average with what the network says of the mirrored crop; twice the time.
    """

    provider: Literal["mini"]
    network: str | None
    long_side: int
    multiple: int
    threshold: float
    mirror: bool


class NormalEstimator:
    """The network by itself, at the size of its inputs.

    Args:
        network: an ONNX file, or None for the bundled one.
        multiple: height and width the network needs are multiples of this, pixels.
        mirror: average with what the network says of the mirrored picture.
        threads: of one inference.

    Raises:
        ModelFileError: the network is missing, altered, or of another signature.
    """

    def __init__(self, network: str | Path | None, multiple: int, mirror: bool, threads: int) -> None:
        self.multiple, self.mirror = multiple, mirror
        self.session = session(network or BUNDLED, threads, SIGNATURE)

    def __call__(
        self, rgb: np.ndarray, mask: np.ndarray, front: np.ndarray, back: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Front and back normals (H, W, 3) float32 of unit length; they mean something inside the mask only.

        Args:
            rgb, mask, front, back: as :func:`soar.networks.normal_inputs.assemble` takes them, of any size.
        """
        height, width = mask.shape
        rest = [(0, -side % self.multiple) for side in (height, width)]
        padded = [np.pad(plane, [*rest, (0, 0)][: plane.ndim]) for plane in (rgb, mask, front, back)]
        inputs = batch([assemble(*padded)])
        outputs = self._run(inputs)
        if self.mirror:
            other = mirrored(self._run(mirrored(inputs)))
            outputs = {name: _unit(value + other[name], 1) for name, value in outputs.items()}
        front, back = (outputs[name][0, :, :height, :width].transpose(1, 2, 0) for name in OUTPUTS)
        return front, back

    def _run(self, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return dict(zip(OUTPUTS, self.session.run(list(OUTPUTS), inputs), strict=True))


class NormalModel:
    """The provider ``mini``: corrects the posed body's normals by what the photograph shows, clothes, hair and limbs
    that are elsewhere. Body and network work at a reduced size; the normals are enlarged to the crop's.

    Raises:
        ModelFileError: as :class:`NormalEstimator`.
    """

    def __init__(self, options: NormalModelSettings, raster: RasterSettings, threads: int) -> None:
        self.options, self.backend = options, raster.backend
        self.estimator = NormalEstimator(options.network, options.multiple, options.mirror, threads)

    def maps(
        self, rgb: np.ndarray, alpha: np.ndarray, vertices: Tensor, faces: Tensor, pinhole: Pinhole
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; zero outside the mask."""
        height, width = alpha.shape
        scale = min(1.0, self.options.long_side / max(height, width))
        view = _scaled(pinhole, round(width * scale), round(height * scale))
        size = (view.width, view.height)
        small, mask = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (rgb, alpha))
        maps = self.estimator(small, mask, *body_maps(vertices, faces, view, self.backend))
        least = 255 * self.options.threshold
        # Beyond the small mask the network was never taught, but enlarging looks half a pixel beyond.
        beyond = nearest_known(mask >= least, np.ones_like(mask, bool))
        front, back = (_enlarged(fill(normals, beyond), alpha >= least) for normals in maps)
        return front, back


def _scaled(pinhole: Pinhole, width: int, height: int) -> Pinhole:
    """The same view on another number of pixels."""
    across, down = width / pinhole.width, height / pinhole.height
    fx, cx, fy, cy = pinhole.fx * across, pinhole.cx * across, pinhole.fy * down, pinhole.cy * down
    return Pinhole(fx, fy, cx, cy, width, height)


def _enlarged(normals: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Normals (h, w, 3) at the size of ``inside`` (H, W), unit there and zero elsewhere."""
    large = cv2.resize(normals, inside.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.where(inside[..., None], _unit(large, -1), np.float32(0))


def _unit(vectors: np.ndarray, axis: int) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=axis, keepdims=True).clip(1e-6)
