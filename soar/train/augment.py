"""What cameras, codecs and mask networks do to a clean render; all amounts are drawn from the generator given."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np


@dataclasses.dataclass(frozen=True)
class PhotoSettings:
    """How a render is spoilt so that it resembles footage.

    Attributes:
        gain: largest change of a colour channel, relative.
        gamma: largest power of the exposure curve, and its inverse.
        saturation: least share of the colour that stays; 1 keeps it.
        blur_px: largest standard deviation of the blur.
        noise: largest standard deviation of the noise, of a range of 1.
        jpeg: share of pictures that are compressed.
        jpeg_quality: least quality.
    """

    gain: float
    gamma: float
    saturation: float
    blur_px: float
    noise: float
    jpeg: float
    jpeg_quality: int


@dataclasses.dataclass(frozen=True)
class MaskSettings:
    """How a perfect mask is spoilt so that it resembles an estimated one.

    Attributes:
        shift: largest dilation or erosion, in shares of the picture's longer side.
        wave: largest wandering of the outline, in the same unit.
        soft: largest width over which the outline fades, in the same unit.
        blobs: share of masks with a piece missing or too much.
    """

    shift: float
    wave: float
    soft: float
    blobs: float


def photograph(rng: np.random.Generator, image: np.ndarray, settings: PhotoSettings) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1] to uint8: exposure, colour, blur, noise, compression."""
    low, high = 1 - settings.gain, 1 + settings.gain
    image = image ** (settings.gamma ** rng.uniform(-1, 1)) * rng.uniform(low, high) * rng.uniform(low, high, 3)
    grey = image.mean(-1, keepdims=True)
    image = grey + (image - grey) * rng.uniform(settings.saturation, 2 - settings.saturation)
    sigma = settings.blur_px * rng.uniform() ** 2
    if sigma > 0.2:
        image = cv2.GaussianBlur(image, (0, 0), sigma)
    image = image + settings.noise * rng.uniform() ** 2 * rng.standard_normal(image.shape, np.float32)
    out = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
    if rng.uniform() < settings.jpeg:
        quality = int(rng.integers(settings.jpeg_quality, 101))
        coded = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        out = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    return out


def spoilt_mask(rng: np.random.Generator, alpha: np.ndarray, settings: MaskSettings) -> np.ndarray:
    """(H, W) float32 in [0, 1] to uint8: an outline moved, wandering, softened, a piece lost or gained."""
    height, width = alpha.shape
    side = max(height, width)
    inside = np.uint8(alpha > 0.5)
    if not inside.any() or inside.all():
        return np.round(255 * alpha).astype(np.uint8)
    # Signed distance to the outline, positive inside: moving the outline is adding to it.
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    distance -= np.sign(distance) * 0.5
    distance += side * settings.shift * rng.uniform(-1, 1)
    cells = int(rng.choice([4, 8, 16]))
    distance += side * settings.wave * rng.uniform() * smooth_noise(rng, height, width, cells, 1)[..., 0]
    if rng.uniform() < settings.blobs:
        rows, columns = np.nonzero(inside)
        pick = rng.integers(len(rows))
        offset = np.hypot(*(np.mgrid[:height, :width] - np.array([rows[pick], columns[pick]])[:, None, None]))
        ball = side * rng.uniform(0.01, 0.06) - offset
        distance = np.minimum(distance, -ball) if rng.uniform() < 0.5 else np.maximum(distance, ball)
    width_of_edge = max(1.0, side * settings.soft * rng.uniform())
    return np.round(255 * np.clip(0.5 + distance / width_of_edge, 0, 1)).astype(np.uint8)


def smooth_noise(rng: np.random.Generator, height: int, width: int, cells: int, channels: int) -> np.ndarray:
    """(H, W, channels) float32 noise of unit variance at its nodes, smooth over ``cells`` nodes across the picture."""
    coarse = rng.standard_normal((cells + 1, cells + 1, channels)).astype(np.float32)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC).reshape(height, width, channels)
