"""What normal maps are made of and from: the crop they are of, axes, windows, and the test of their signs.

Normals are unit vectors in the camera's OpenCV space (x right, y down, z forward), zero where there is no surface.
The front map shows the surface nearest to the camera (n_z < 0). The back map shows the farthest one, pixel-aligned
with the front and not mirrored (n_z > 0), which is what a surfel pass in descending order renders.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from torch import Tensor

from soar.raster import Pinhole
from soar.raster.types import Backend

Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels of a picture, whose pixel (0, 0) reaches from 0 to 1; it may leave the picture."""

GL = np.array([1, -1, -1], np.float32)
"""Signs between this project's axes and OpenGL's (x right, y up, z to the viewer), which most networks use."""


@dataclasses.dataclass(frozen=True)
class Crop:
    """A window of one frame, and the body posed in it.

    Attributes:
        rgb: (H, W, 3) uint8 picture.
        alpha: (H, W) uint8 soft mask of the person.
        vertices: (V, 3) the posed body in the camera's space, metres.
        faces: (F, 3) its visible faces, counter-clockwise seen from outside.
        pinhole: the crop's view.
        frame: number of the frame in its recording.
        box: the window in pixels of the whole stored frame.
        size: width and height of the whole stored frame, pixels.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    vertices: Tensor
    faces: Tensor
    pinhole: Pinhole
    frame: int
    box: Box
    size: tuple[int, int]


@dataclasses.dataclass(frozen=True)
class Context:
    """What a provider is given besides its settings.

    Attributes:
        brought: files and folders of the user's, by the key of the configuration that names them.
        crops: what maps will be asked of; a crop is made when it is looked at.
        frames: number in its recording of each crop's frame.
        backend: of the z-buffer.
        threads: of one inference.
    """

    brought: Mapping[str, Path]
    crops: Sequence[Crop]
    frames: Sequence[int]
    backend: Backend
    threads: int


def encode(normals: np.ndarray) -> np.ndarray:
    """Normals (..., 3) in [-1, 1] as int8 round(127 n)."""
    return np.round(127 * normals).astype(np.int8)


def unit(vectors: np.ndarray, axis: int = -1) -> np.ndarray:
    """Vectors of length 1 along ``axis``; shorter than 1e-6 they are only enlarged."""
    return vectors / np.linalg.norm(vectors, axis=axis, keepdims=True).clip(1e-6)


def from_network(planes: np.ndarray) -> np.ndarray:
    """Unit normals (h, w, 3) from a network's (1, 3, h, w) of any length in OpenGL's axes; zero where it gave NaN."""
    return GL * unit(np.nan_to_num(planes[0].transpose(1, 2, 0), nan=0.0))


def settled(normals: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Resampled normals (H, W, 3) made unit inside a mask (H, W), zero elsewhere."""
    return np.where(inside[..., None], unit(normals), np.float32(0))


def sampled(image: np.ndarray, box: Box, width: int, height: int) -> np.ndarray:
    """The part ``box`` of an image (h, w) or (h, w, C), resampled to ``width`` x ``height``; zero beyond the image.

    Areas are averaged where it shrinks; it is linear in between where it grows.
    """
    x0, y0, x1, y1 = box
    # What lies far outside the box need not be shrunk.
    rows, columns = (slice(max(int(a) - 2, 0), max(int(np.ceil(b)) + 2, 0)) for a, b in ((y0, y1), (x0, x1)))
    part = image[rows, columns]
    if not part.size:
        return np.zeros((height, width, *image.shape[2:]), image.dtype)
    x0, x1, y0, y1 = x0 - columns.start, x1 - columns.start, y0 - rows.start, y1 - rows.start
    across, down = (x1 - x0) / width, (y1 - y0) / height
    if max(across, down) > 1:
        size = (max(round(part.shape[1] / max(across, 1)), 1), max(round(part.shape[0] / max(down, 1)), 1))
        sx, sy = size[0] / part.shape[1], size[1] / part.shape[0]
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        x0, y0, across, down = x0 * sx, y0 * sy, across * sx, down * sy
    # OpenCV counts the centre of a pixel as whole, not as half.
    matrix = np.array([[across, 0, x0 + across / 2 - 0.5], [0, down, y0 + down / 2 - 0.5]])
    return cv2.warpAffine(
        part, matrix, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT
    )


def seen_from(box: Box, other: Box, width: int, height: int) -> Box:
    """``box`` in pixels of the ``width`` x ``height`` picture that shows ``other``; both are given in one picture."""
    sx, sy = width / (other[2] - other[0]), height / (other[3] - other[1])
    return tuple((value - start) * scale for value, start, scale in zip(box, other[:2] * 2, (sx, sy) * 2, strict=True))


def windowed(pinhole: Pinhole, box: Box, width: int, height: int) -> Pinhole:
    """The view of the part ``box`` of a view's picture, on ``width`` x ``height`` pixels."""
    x0, y0, x1, y1 = box
    across, down = width / (x1 - x0), height / (y1 - y0)
    cx, cy = (pinhole.cx - x0) * across, (pinhole.cy - y0) * down
    return Pinhole(pinhole.fx * across, pinhole.fy * down, cx, cy, width, height)


@dataclasses.dataclass(frozen=True)
class Signs:
    """What the signs of a map say of its axes; all NaN of a map without a surface.

    Attributes:
        facing: median n_z.
        left, right: mean n_x over the left and right third of each row's surface.
        top, bottom: mean n_y over the upper and lower third of each column's surface.
    """

    facing: float
    left: float
    right: float
    top: float
    bottom: float

    @staticmethod
    def of(normals: np.ndarray) -> Signs:
        """Of a map (H, W, 3)."""
        inside = np.abs(normals).max(-1) > 0
        if not inside.any():
            return Signs(*[float("nan")] * 5)

        def share(axis: int) -> np.ndarray:
            """Share of the surface pixels of a row or column that come before each one."""
            return (np.cumsum(inside, axis) - 0.5) / np.maximum(inside.sum(axis, keepdims=True), 1)

        across, down = share(1), share(0)
        return Signs(
            facing=float(np.median(normals[inside][:, 2])),
            left=float(normals[inside & (across < 1 / 3)][:, 0].mean()),
            right=float(normals[inside & (across > 2 / 3)][:, 0].mean()),
            top=float(normals[inside & (down < 1 / 3)][:, 1].mean()),
            bottom=float(normals[inside & (down > 2 / 3)][:, 1].mean()),
        )

    @property
    def upright(self) -> bool:
        """Whether x and y are this project's. A closed surface turns outward at its sides, whatever its shape and pose.

        A camera that looks down or a person who leans shifts top and bottom, so it is their order that tells.
        """
        return self.left < 0 < self.right and self.top < self.bottom

    @property
    def front(self) -> bool:
        """Whether the map is a front map in this project's convention."""
        return self.upright and self.facing < 0

    @property
    def back(self) -> bool:
        """Whether the map is a back map in this project's convention, pixel-aligned with the front."""
        return self.upright and self.facing > 0


@dataclasses.dataclass(frozen=True)
class SignTest(Signs):
    """Signs of a front map, and of the back map on it.

    Attributes:
        behind: median n_z of the back map.
    """

    behind: float

    @property
    def passed(self) -> bool:
        """Whether every sign is this project's."""
        return self.front and self.behind > 0


def sign_test(front: np.ndarray, back: np.ndarray) -> SignTest:
    """Test maps (H, W, 3) for mirrored, flipped or swapped axes; failed where either has no surface."""
    return SignTest(**dataclasses.asdict(Signs.of(front)), behind=Signs.of(back).facing)
