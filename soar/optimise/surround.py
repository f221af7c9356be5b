"""Four cameras round a posed body, and the pictures of the person that a prior is shown (ImageDream's set-up)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import cv2
import numpy as np
import torch
from torch import Tensor

from soar.body.lbs import pose_vertices
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.geometry.cameras import look_at
from soar.optimise.views import Views
from soar.priors.geometry import BodyGeometry, enlarged
from soar.priors.protocol import VIEWS, Condition, Domain
from soar.raster import Pinhole


@dataclasses.dataclass(frozen=True)
class SurroundSettings:
    """Where the four cameras stand (node ``refine.views``); each range is drawn from uniformly, once a step.

    Attributes:
        elevation: (least, most) degrees above the person's level.
        fov: (least, most) degrees, field of view of the square pictures.
        fill: (least, most) share of the picture's side that the body's larger extent fills.
        prompt_fill: share of the image prompt's side that the mask's larger extent fills.
        samples: pixels rendered for each of the prior's, per side.
    """

    elevation: tuple[float, float]
    fov: tuple[float, float]
    fill: tuple[float, float]
    prompt_fill: float
    samples: int


@dataclasses.dataclass(frozen=True)
class Look:
    """One of the four cameras.

    Attributes:
        T_cam_from_world: (4, 4) float32.
        pinhole: at the prior's resolution.
        azimuth: degrees from where the image prompt was taken, towards the left of a person who faces that camera.
        elevation: degrees above the horizon.
    """

    T_cam_from_world: Tensor
    pinhole: Pinhole
    azimuth: float
    elevation: float


class Surround:
    """The body in motion as cameras around it see it.

    Args:
        body, motion: what stands in the middle.
        up: (3,) the scene's.
        settings: see :class:`SurroundSettings`.
        size: side of the prior's pictures, pixels.
    """

    def __init__(
        self, body: BodyModel, motion: BodyMotion, up: np.ndarray, settings: SurroundSettings, size: int
    ) -> None:
        self.body, self.motion, self.settings, self.size = body, motion, settings, size
        self.up = up / np.linalg.norm(up)
        self.geometry, self._rotations = BodyGeometry(body), motion.rotations
        self._posed: dict[int, tuple[Tensor, Tensor]] = {}

    def posed(self, frame: int) -> tuple[Tensor, Tensor]:
        """Vertices (V, 3), metres, and unit normals (V, 3) of the body in the world."""
        if frame not in self._posed:
            motion = self.motion
            vertices = pose_vertices(self.body, motion.betas, self._rotations[frame], motion.translation[frame])
            self._posed[frame] = vertices, self.geometry.normals(vertices)
        return self._posed[frame]

    def planes(self, frame: int, T_cam_from_world: Tensor, pinhole: Pinhole) -> Tensor:
        """(7, H, W) the body's geometry in a view, :mod:`soar.networks.prior_inputs`."""
        vertices, normals = self.posed(frame)
        R, t = T_cam_from_world[:3, :3], T_cam_from_world[:3, 3]
        return self.geometry.planes(vertices @ R.T + t, normals @ R.T, pinhole)

    def looks(self, frame: int, T_cam_from_world: Tensor, draw: Tensor) -> list[Look]:
        """Four cameras, 90 degrees apart, that look at the middle of a frame's body; what it fills is ``fill``.

        Args:
            frame: of the motion.
            T_cam_from_world: (4, 4) of the camera that took the image prompt: azimuth 0 is its side.
            draw: (4,) in [0, 1]: where in a quarter of the circle the first stands, elevation, field of view, fill.
        """
        turn, level, lens, share = draw.tolist()
        options = self.settings
        elevation, fov, fill = (
            low + (high - low) * at
            for (low, high), at in ((options.elevation, level), (options.fov, lens), (options.fill, share))
        )
        points = self.posed(frame)[0].double().cpu().numpy()
        eye = -np.linalg.inv(T_cam_from_world[:3, :3].double().cpu().numpy()) @ T_cam_from_world[:3, 3].cpu().numpy()
        front = eye - points.mean(0)
        front -= (front @ self.up) * self.up
        front /= np.linalg.norm(front)
        side = np.cross(self.up, front)
        axes = np.stack([side, front, self.up])
        local = points @ axes.T
        low, high = local.min(0), local.max(0)
        extent = max(float((high - low)[2]), float(np.linalg.norm((high - low)[:2]))) / fill
        distance = extent / 2 / np.tan(np.deg2rad(fov) / 2)
        focal, middle = self.size * distance / extent, self.size / 2
        pinhole = Pinhole(focal, focal, middle, middle, self.size, self.size)
        looks = []
        for k in range(VIEWS):
            azimuth = 90 * (turn + k)
            a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
            outward = np.cos(e) * (np.cos(a) * front + np.sin(a) * side) + np.sin(e) * self.up
            T = look_at((low + high) / 2 @ axes, -outward, self.up, distance)
            looks.append(Look(torch.from_numpy(T).float(), pinhole, azimuth, elevation))
        return looks

    def fine(self, look: Look) -> Pinhole:
        """The view at the resolution that is rendered."""
        return enlarged(look.pinhole, self.settings.samples)

    def conditions(self, views: Views, index: int, domains: Iterable[Domain], text: str) -> list[Condition]:
        """Crop ``index`` as the image prompt of each domain: a square about the mask; the estimated front normals."""
        window = _square(views.alpha[index], self.settings.prompt_fill)
        alpha = _resized(views.alpha[index].astype(np.float32) / 255, window, self.size)
        K = views.K[index].astype(float).copy()
        K[:2, 2] -= window[:2]
        K[:2] *= self.size / window[2]
        pinhole = Pinhole.from_K(K, self.size, self.size)
        geometry = self.planes(int(views.frames[index]), views.T_cam_from_world, pinhole)
        pictures = {domain: self._picture(views, index, domain, window, alpha) for domain in domains}
        return [
            Condition(domain, torch.from_numpy(picture), torch.from_numpy(alpha[None]), geometry, text)
            for domain, picture in pictures.items()
        ]

    def _picture(
        self, views: Views, index: int, domain: Domain, window: tuple[int, int, int], alpha: np.ndarray
    ) -> np.ndarray:
        """(3, S, S) float32 in [0, 1], times the ``alpha`` (S, S) of the window."""
        if domain == "normal":
            assert views.normals is not None
            normal = _resized(views.normals[index, 0].astype(np.float32) / 127, window, self.size)
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
            picture = (normal + 1) / 2 * alpha[..., None]
        else:
            masked = views.rgb[index].astype(np.float32) * (views.alpha[index].astype(np.float32) / 255**2)[..., None]
            picture = _resized(masked, window, self.size)
        return np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32)


def _square(alpha: np.ndarray, fill: float) -> tuple[int, int, int]:
    """Left, top and side, pixels, of the square about what a mask (H, W) uint8 covers; it may leave the image."""
    rows, columns = np.flatnonzero((alpha > 127).any(1)), np.flatnonzero((alpha > 127).any(0))
    if not rows.size:
        height, width = alpha.shape
        rows, columns = np.array([0, height - 1]), np.array([0, width - 1])
    extent = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
    side = int(np.ceil(extent / fill))
    return (columns[0] + columns[-1] + 1 - side) // 2, (rows[0] + rows[-1] + 1 - side) // 2, side


def _resized(image: np.ndarray, window: tuple[int, int, int], size: int) -> np.ndarray:
    """A square window of an image (H, W) or (H, W, C) float32, zero beyond it, at ``size`` pixels."""
    left, top, side = window
    before = max(-top, 0), max(-left, 0)
    inside = image[max(top, 0) : top + side, max(left, 0) : left + side]
    after = side - before[0] - inside.shape[0], side - before[1] - inside.shape[1]
    padded = np.pad(inside, [(before[0], after[0]), (before[1], after[1]), *[(0, 0)] * (image.ndim - 2)])
    return cv2.resize(padded, (size, size), interpolation=cv2.INTER_AREA if side > size else cv2.INTER_LINEAR)
