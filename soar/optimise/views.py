"""What was observed: the fixed-size crops of one camera over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from soar.errors import ArtifactError
from soar.raster import Pinhole


@dataclasses.dataclass(frozen=True)
class Views:
    """T crops of one camera. Images stay bytes; one is converted at a time.

    Attributes:
        camera: name.
        rgb: (T, H, W, 3) uint8 photographs.
        alpha: (T, H, W) uint8 soft masks.
        K: (T, 3, 3) intrinsics of each crop, pixels.
        T_cam_from_world: (4, 4) float32.
        frames: (T,) index of each crop's frame in the motion.
        normals: (T, 2, H, W, 3) int8, front and back maps times 127; None where nobody estimated them.
        windows: (T, 4) rows from, to, columns from, to: the part of each crop that is looked at.
    """

    camera: str
    rgb: np.ndarray
    alpha: np.ndarray
    K: np.ndarray
    T_cam_from_world: Tensor
    frames: np.ndarray
    normals: np.ndarray | None
    windows: np.ndarray

    @staticmethod
    def of(camera: str, crops: Mapping[str, np.ndarray], normals: Mapping[str, np.ndarray] | None = None) -> Views:
        """From the arrays of ``crops/{camera}.npz`` and, if there are any, ``normals/{camera}.npz``.

        Raises:
            ArtifactError: the two files do not belong together.
        """
        maps = None
        if normals is not None:
            if normals["front"].shape != crops["rgb"].shape or normals["back"].shape != crops["rgb"].shape:
                raise ArtifactError(
                    f"the normal maps of camera {camera} do not fit its crops",
                    expected=str(crops["rgb"].shape),
                    got=f"front {normals['front'].shape}, back {normals['back'].shape}",
                    cure="delete the sequence's normals folder and run snakemake; it is made again",
                )
            maps = np.stack([normals["front"], normals["back"]], 1)
        T = torch.from_numpy(np.asarray(crops["T_cam_from_world"], np.float32))
        count, height, width = crops["alpha"].shape
        whole = np.tile([0, height, 0, width], (count, 1))
        return Views(camera, crops["rgb"], crops["alpha"], crops["K"], T, crops["frame_index"], maps, whole)

    def hardened(self, low: float, high: float) -> Views:
        """The same crops with mask values ``low`` and below taken to 0, ``high`` and above to 1, a ramp in between.

        Opaque surfels cannot be half there: a wide soft border is answered with a frayed silhouette.
        """
        table = np.clip((np.arange(256) / 255 - low) / (high - low), 0, 1)
        return dataclasses.replace(self, alpha=np.rint(255 * table).astype(np.uint8)[self.alpha])

    def tightened(self, margin: int, multiple: int = 16) -> Views:
        """The same crops seen through windows around the person, ``margin`` pixels wider than the mask above one half.

        Nothing happens outside, and every image operation costs by the pixel. Sides are multiples of ``multiple``
        unless the crop ends before.
        """
        height, width = self.alpha.shape[1:]
        windows = self.windows.copy()
        for window, alpha in zip(windows, self.alpha, strict=True):
            for k, (axis, side) in enumerate(((1, height), (0, width))):
                used = np.flatnonzero((alpha > 127).any(axis=axis))
                if used.size:
                    low, high = max(used[0] - margin, 0), min(used[-1] + 1 + margin, side)
                    length = min(-(-(high - low) // multiple) * multiple, side)
                    low = min(low, side - length)
                    window[2 * k : 2 * k + 2] = low, low + length
        return dataclasses.replace(self, windows=windows)

    def __len__(self) -> int:
        return len(self.rgb)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the crops in pixels."""
        return self.alpha.shape[1], self.alpha.shape[2]

    def _part(self, images: np.ndarray, index: int) -> np.ndarray:
        top, bottom, left, right = self.windows[index]
        return (
            images[index, ..., top:bottom, left:right]
            if images.ndim == 3
            else images[index, ..., top:bottom, left:right, :]
        )

    def share(self, index: int) -> float:
        """Area of window ``index`` over that of the crop: turns a mean over the window into one over the crop."""
        top, bottom, left, right = self.windows[index]
        return float((bottom - top) * (right - left)) / self.alpha[index].size

    def image(self, index: int) -> Tensor:
        """Photograph ``index`` as (3, H, W) in [0, 1]."""
        return torch.from_numpy(self._part(self.rgb, index).transpose(2, 0, 1).astype(np.float32) / 255)

    def mask(self, index: int) -> Tensor:
        """Soft mask ``index`` as (H, W) in [0, 1]."""
        return torch.from_numpy(self._part(self.alpha, index).astype(np.float32) / 255)

    def normal_maps(self, index: int) -> tuple[Tensor, Tensor]:
        """Front and back normals ``index``, each (3, H, W), unit, zero where unknown; only where maps were given."""
        assert self.normals is not None
        maps = self._part(self.normals, index).transpose(0, 3, 1, 2).astype(np.float32) / 127
        return torch.from_numpy(maps[0]), torch.from_numpy(maps[1])

    def pinhole(self, index: int) -> Pinhole:
        """Camera of window ``index``."""
        top, bottom, left, right = self.windows[index]
        K = self.K[index].copy()
        K[0, 2] -= left
        K[1, 2] -= top
        return Pinhole.from_K(K, right - left, bottom - top)


def epochs(views: list[Views], steps: int, generator: torch.Generator) -> list[tuple[int, int]]:
    """``steps`` pairs (view, index): every crop of every camera once, in random order, before any comes again."""
    pairs = [(v, i) for v, view in enumerate(views) for i in range(len(view))]
    order: list[tuple[int, int]] = []
    while len(order) < steps:
        order += [pairs[k] for k in torch.randperm(len(pairs), generator=generator).tolist()]
    return order[:steps]
