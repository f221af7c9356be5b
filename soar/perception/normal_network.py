"""Normals of the clothed person by a network that sees the photograph and the posed body."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from soar.models.onnx import session
from soar.networks import DATA
from soar.networks.normal_inputs import OUTPUTS, SIGNATURE, assemble, batch, fill, mirrored, nearest_known
from soar.perception.body_normals import body_maps
from soar.perception.normal_maps import Context, Crop, settled, unit, windowed

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
            outputs = {name: unit(value + other[name], 1) for name, value in outputs.items()}
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

    remarks = ()

    def __init__(self, options: NormalModelSettings, context: Context) -> None:
        self.options, self.backend = options, context.backend
        network = context.brought.get("network")
        self.estimator = NormalEstimator(network, options.multiple, options.mirror, context.threads)

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`soar.perception.normals.NormalProvider`; zero outside the mask."""
        height, width = crop.alpha.shape
        scale = min(1.0, self.options.long_side / max(height, width))
        size = (round(width * scale), round(height * scale))
        small, mask = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (crop.rgb, crop.alpha))
        view = windowed(crop.pinhole, (0, 0, width, height), *size)
        maps = self.estimator(small, mask, *body_maps(crop.vertices, crop.faces, view, self.backend))
        least = 255 * self.options.threshold
        # Beyond the small mask the network was never taught, but enlarging looks half a pixel beyond.
        beyond = nearest_known(mask >= least, np.ones_like(mask, bool))
        large = (cv2.resize(fill(normals, beyond), (width, height), interpolation=cv2.INTER_LINEAR) for normals in maps)
        front, back = (settled(normals, crop.alpha >= least) for normals in large)
        return front, back
