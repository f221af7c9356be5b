"""Front and back normal maps of the person, and the test that a map is in the convention of this project.

Normals are unit vectors in the camera's OpenCV space (x right, y down, z forward), zero where there is no surface.
The front map shows the surface nearest to the camera (n_z < 0). The back map shows the farthest one, pixel-aligned
with the front and not mirrored (n_z > 0), which is what a surfel pass in descending order renders.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from soar.config import settings
from soar.errors import ConfigError
from soar.perception.body_normals import BodyNormals, BodyNormalSettings
from soar.perception.normal_network import NormalModel, NormalModelSettings
from soar.raster import Pinhole, RasterSettings


class NormalProvider(Protocol):
    """Estimates both maps of one crop."""

    def maps(
        self, rgb: np.ndarray, alpha: np.ndarray, vertices: Tensor, faces: Tensor, pinhole: Pinhole
    ) -> tuple[np.ndarray, np.ndarray]:
        """Front and back normals, each (H, W, 3) float32.

        Args:
            rgb: (H, W, 3) uint8 crop.
            alpha: (H, W) uint8 mask.
            vertices: (V, 3) the posed body in the camera's space, metres.
            faces: (F, 3) its visible faces, counter-clockwise seen from outside.
            pinhole: the crop's view.
        """
        ...


PROVIDERS = {"body": (BodyNormalSettings, BodyNormals), "mini": (NormalModelSettings, NormalModel)}


def normal_provider(node: Mapping[str, Any], raster: RasterSettings, threads: int) -> NormalProvider:
    """The provider that the configuration node ``normals`` names; a network may use ``threads`` threads.

    Raises:
        ConfigError: an unknown provider or setting.
        ModelFileError: the provider's network is missing, altered, or of another signature.
    """
    name = node.get("provider")
    if name not in PROVIDERS:
        raise ConfigError(
            "unknown provider normals.provider", expected=", ".join(PROVIDERS), got=repr(name), cure="see conf/normals"
        )
    schema, provider = PROVIDERS[name]
    return provider(settings(schema, node, "normals"), raster, threads)


def encode(normals: np.ndarray) -> np.ndarray:
    """Normals (..., 3) in [-1, 1] as int8 round(127 n)."""
    return np.round(127 * normals).astype(np.int8)


@dataclasses.dataclass(frozen=True)
class SignTest:
    """Signs that a closed surface shows in this project's convention, whatever its shape and pose.

    Attributes:
        facing: median n_z of the front map; negative.
        left, right: mean front n_x over the left and right third of each row's surface; negative, positive.
        top, bottom: mean front n_y over the upper and lower third of each column's surface. A camera that looks down
            or a person who leans shifts both, so it is their order that tells: top below bottom.
        behind: median n_z of the back map; positive.
    """

    facing: float
    left: float
    right: float
    top: float
    bottom: float
    behind: float

    @property
    def passed(self) -> bool:
        """Whether every sign is right."""
        return self.facing < 0 < self.behind and self.left < 0 < self.right and self.top < self.bottom


def sign_test(front: np.ndarray, back: np.ndarray) -> SignTest:
    """Test maps (H, W, 3) for mirrored, flipped or swapped axes; all NaN, hence failed, where there is no surface."""
    inside = np.abs(front).max(-1) > 0
    behind = np.abs(back).max(-1) > 0
    if not (inside.any() and behind.any()):
        return SignTest(*[float("nan")] * 6)

    def share(axis: int) -> np.ndarray:
        """Share of the surface pixels of a row or column that come before each one."""
        return (np.cumsum(inside, axis) - 0.5) / np.maximum(inside.sum(axis, keepdims=True), 1)

    across, down = share(1), share(0)
    return SignTest(
        facing=float(np.median(front[inside][:, 2])),
        left=float(front[inside & (across < 1 / 3)][:, 0].mean()),
        right=float(front[inside & (across > 2 / 3)][:, 0].mean()),
        top=float(front[inside & (down < 1 / 3)][:, 1].mean()),
        bottom=float(front[inside & (down > 2 / 3)][:, 1].mean()),
        behind=float(np.median(back[behind][:, 2])),
    )
