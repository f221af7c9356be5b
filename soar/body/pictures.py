"""Pictures of fits: the shaded body over a frame, two bodies from the side, residuals of joints."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch

from soar.body.record import BodyModel
from soar.geometry.cameras import Camera
from soar.geometry.meshes import vertex_normals
from soar.raster import Pinhole, rasterise_mesh

BLUE, ORANGE, RED, GREEN = (70, 130, 235), (240, 150, 50), (225, 60, 50), (60, 185, 90)
SUBPIXEL = 3  # binary digits of the positions given to OpenCV's drawing functions


def shade(
    camera: Camera, vertices: np.ndarray, model: BodyModel, colour: Sequence[int] | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The body lit from the camera.

    Args:
        camera: the view.
        vertices: (V, 3) world metres.
        model: for its faces.
        colour: RGB of 0 to 255, one or (V, 3) one for each vertex.

    Returns:
        (H, W, 3) float32 picture in [0, 255] and (H, W) float32 depth, infinite beside the body.
    """
    local = torch.from_numpy(camera.to_camera(vertices).astype(np.float32))
    pinhole = Pinhole.from_K(camera.K, camera.width, camera.height)
    fragments = rasterise_mesh(local, model.faces, pinhole, "front")
    face = torch.as_tensor(fragments.face)
    facing = -vertex_normals(local, model.faces)[:, 2]
    corners = model.faces[face.clamp_min(0).long()]
    shares = torch.as_tensor(fragments.barycentrics)
    light = (shares * facing[corners]).sum(-1).clamp(0, 1).numpy()
    own = np.asarray(colour, np.float32)
    if own.ndim == 2:
        own = (shares[..., None] * torch.from_numpy(own)[corners]).sum(-2).numpy()
    picture = (0.25 + 0.75 * light[..., None]) * own
    return picture, np.asarray(fragments.depth)


def draw_body(
    image: np.ndarray,
    camera: Camera,
    vertices: np.ndarray,
    model: BodyModel,
    colour: Sequence[int] | np.ndarray = BLUE,
    opacity: float = 0.55,
) -> np.ndarray:
    """(H, W, 3) uint8: the shaded body over the frame, with its outline."""
    picture, depth = shade(camera, vertices, model, colour)
    inside = np.isfinite(depth)
    out = np.where(inside[..., None], (1 - opacity) * image + opacity * picture, image).astype(np.uint8)
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(out, contours, -1, (255, 255, 255), 2, cv2.LINE_AA)
    return out


def draw_pair(
    camera: Camera, bodies: Sequence[np.ndarray], colours: Sequence[Sequence[int]], model: BodyModel
) -> np.ndarray:
    """(H, W, 3) uint8: bodies (V, 3) on white, the nearer surface in front."""
    out = np.full((camera.height, camera.width, 3), 255, np.float32)
    nearest = np.full(out.shape[:2], np.inf, np.float32)
    for vertices, colour in zip(bodies, colours, strict=True):
        picture, depth = shade(camera, vertices, model, colour)
        front = depth < nearest
        out[front], nearest[front] = picture[front], depth[front]
    return out.astype(np.uint8)


def side_camera(camera: Camera, centre: np.ndarray, up: np.ndarray) -> Camera:
    """The camera carried a quarter turn about the vertical axis through ``centre`` (3,); it keeps its distance.

    Looking from the side shows what a single camera cannot see: errors of depth and of leaning.
    """
    a, b, c = up
    K = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    turn = np.eye(3) + K + K @ K  # Rodrigues' formula at a right angle
    R = camera.R @ turn.T
    depth = camera.to_camera(centre)[2]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.array([0, 0, depth]) - R @ centre
    intrinsics = camera.K.copy()
    intrinsics[:2, 2] = camera.width / 2, camera.height / 2
    return Camera(f"{camera.name} side", camera.width, camera.height, intrinsics, T, np.zeros(5), camera.K_source)


def draw_residuals(
    image: np.ndarray, points: np.ndarray, residuals: Sequence[np.ndarray], magnify: float
) -> np.ndarray:
    """Residual vectors (N, 2), ``magnify`` times as long, from points (N, 2); first red, then green; NaN = none."""
    out = (0.6 * image).astype(np.uint8)
    for residual, colour in zip(residuals, (RED, GREEN), strict=True):
        for start, step in zip(points, residual, strict=True):
            if np.isfinite(step).all():
                end = start + magnify * step
                a, b = (tuple(np.round(p * 2**SUBPIXEL).astype(int).tolist()) for p in (start, end))
                cv2.line(out, a, b, colour, 3, cv2.LINE_AA, SUBPIXEL)
                cv2.circle(out, a, 5 << SUBPIXEL, (255, 255, 255), -1, cv2.LINE_AA, SUBPIXEL)
    return out


def scatter(residuals: Sequence[np.ndarray], size: int, span: float) -> np.ndarray:
    """Residuals (N, 2) in pixels as dots, red then green, in a square of +-``span`` pixels, rings every ten."""
    out = np.full((size, size, 3), 255, np.uint8)
    middle, scale = size / 2, size / 2 / span
    for ring in range(10, int(span) + 1, 10):
        cv2.circle(out, (size // 2, size // 2), round(ring * scale), (205, 205, 205), 1, cv2.LINE_AA)
        cv2.putText(
            out,
            f"{ring} px",
            (size // 2 + 2, round(middle - ring * scale) + 12),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.35,
            (120, 120, 120),
            1,
        )
    for residual, colour in zip(residuals, (RED, GREEN), strict=True):
        flat = residual.reshape(-1, 2)
        for x, y in flat[np.isfinite(flat).all(1)] * scale + middle:
            if 0 <= x < size and 0 <= y < size:
                cv2.circle(out, (round(x), round(y)), 2, colour, -1, cv2.LINE_AA)
    return out


def window(points: np.ndarray, shape: tuple[int, int], margin: float) -> tuple[slice, slice]:
    """Rows and columns of an image (H, W) around finite points (..., 2), ``margin`` times their extent wider."""
    flat = points.reshape(-1, 2)
    flat = flat[np.isfinite(flat).all(1)]
    if not len(flat):
        return slice(0, shape[0]), slice(0, shape[1])
    low, high = flat.min(0), flat.max(0)
    pad = margin * (high - low).max()
    x0, y0 = np.maximum(np.floor(low - pad), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(high + pad), (shape[1], shape[0])).astype(int)
    if x1 <= x0 or y1 <= y0:
        return slice(0, shape[0]), slice(0, shape[1])
    return slice(y0, y1), slice(x0, x1)
