"""Drawing helpers shared by every stage's evidence picture.

Images are (H, W, 3) RGB or (H, W) grey arrays, either uint8 or float in [0, 1]; results are uint8 RGB.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

INK, PAPER = (235, 235, 235), (32, 34, 38)
SEEN, UNSEEN = np.array([0.88, 0.89, 0.90]), np.array([0.85, 0.16, 0.13])


def spread(count: int, shown: int) -> list[int]:
    """At most ``shown`` indices spread over ``range(count)``, ends included."""
    return np.unique(np.linspace(0, count - 1, shown).round().astype(int)).tolist()


def to_uint8(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) RGB uint8 of a float [0, 1], uint8 or boolean image, colour or grey; out-of-range values clip."""
    if image.dtype != np.uint8:
        image = np.round(np.clip(image.astype(np.float32), 0.0, 1.0) * 255.0).astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def to_float(image: np.ndarray) -> np.ndarray:
    """float32 in [0, 1] of a uint8, boolean or float image; the shape is kept."""
    return image.astype(np.float32) / 255.0 if image.dtype == np.uint8 else image.astype(np.float32)


def composite(colour: np.ndarray, alpha: np.ndarray, background: float | Sequence[float] = 1.0) -> np.ndarray:
    """Straight colour over a background: ``alpha * colour + (1 - alpha) * background``.

    Args:
        colour: (H, W, 3) RGB, not premultiplied.
        alpha: (H, W) coverage in [0, 1] or uint8.
        background: a grey level or an RGB triple in [0, 1].

    Returns:
        (H, W, 3) float32 in [0, 1] (not uint8, so that metrics can use it).
    """
    a = to_float(alpha)[..., None]
    return a * to_float(colour) + (1.0 - a) * np.asarray(background, np.float32)


def colour_normals(normals: np.ndarray, background: float = 1.0) -> np.ndarray:
    """Camera-space normals as colours: ``(n * (1, -1, -1) + 1) / 2``, so that a normal facing the camera is light blue.

    Args:
        normals: (H, W, 3) float, unit length, or int8 holding ``round(127 n)``; zero where there is no surface.
        background: grey level of pixels without a surface.
    """
    n = normals.astype(np.float32) / (127.0 if normals.dtype == np.int8 else 1.0)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    unit = n / np.maximum(length, 1e-6)
    coloured = (unit * np.array([1.0, -1.0, -1.0], np.float32) + 1.0) / 2.0
    return to_uint8(np.where(length > 1e-3, coloured, background))


def colour_occlusion(occlusion: np.ndarray, alpha: np.ndarray, background: float = 1.0) -> np.ndarray:
    """Occlusion values as colours: light grey was seen in training, red was never seen.

    Args:
        occlusion: (H, W) in [0, 1], 1 = never seen.
        alpha: (H, W) coverage of the avatar.
        background: grey level around the avatar.
    """
    tau = np.clip(to_float(occlusion), 0.0, 1.0)[..., None]
    return to_uint8(composite((1.0 - tau) * SEEN + tau * UNSEEN, alpha, background))


def overlay_mask(
    image: np.ndarray, mask: np.ndarray, colour: Sequence[float] = (0.1, 0.8, 0.4), opacity: float = 0.35
) -> np.ndarray:
    """Tint the masked pixels and draw the mask's outline.

    Args:
        image: (H, W, 3) picture.
        mask: (H, W) soft mask; inside is above one half.
        colour: RGB in [0, 1] of tint and outline.
        opacity: strength of the tint; 0 draws the outline alone.
    """
    inside = to_float(mask) > 0.5
    base = to_float(to_uint8(image))
    tinted = np.where(inside[..., None], (1.0 - opacity) * base + opacity * np.asarray(colour, np.float32), base)
    out = to_uint8(tinted)
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(out, contours, -1, tuple(round(255 * c) for c in colour), 1, cv2.LINE_AA)
    return out


def fit(image: np.ndarray, width: int, height: int, background: float = 1.0) -> np.ndarray:
    """Scale an image to fit into ``width`` x ``height`` pixels, centred, keeping its aspect ratio."""
    picture = to_uint8(image)
    scale = min(width / picture.shape[1], height / picture.shape[0])
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    out = np.full((height, width, 3), round(255 * background), np.uint8)
    x, y = (width - size[0]) // 2, (height - size[1]) // 2
    out[y : y + size[1], x : x + size[0]] = small
    return out


def label(image: np.ndarray, text: str, size: int = 14) -> np.ndarray:
    """Add a strip with ``text`` above the image; text that is too wide is drawn smaller, but never under 8 pixels.

    Args:
        image: (H, W, 3) picture.
        text: one line of Unicode text.
        size: letter size in pixels.
    """
    picture, font = to_uint8(image), cv2.FontFace("sans")
    width, room = picture.shape[1], picture.shape[1] - 8
    strip = np.full((round(size * 1.6), width, 3), PAPER, np.uint8)
    drawn = cv2.getTextSize((4096, 64), text, (0, 0), font, size, 500)[2] if text else 0
    letters = max(8, size * room // drawn) if drawn > room else size
    cv2.putText(strip, text, (4, round(size * 1.15)), INK, font, letters, 500)
    return np.concatenate([strip, picture])


def grid(images: Sequence[np.ndarray], columns: int, labels: Sequence[str] | None = None, gap: int = 4) -> np.ndarray:
    """Contact sheet: images row by row, each scaled into a cell of the largest width and height.

    Args:
        images: at least one picture.
        columns: pictures per row; a last row that is not full stays white.
        labels: one line above each picture; no strip at all when None.
        gap: white pixels between cells.
    """
    pictures = [to_uint8(image) for image in images]
    height, width = (max(p.shape[axis] for p in pictures) for axis in (0, 1))
    cells = [p if p.shape[:2] == (height, width) else fit(p, width, height) for p in pictures]
    if labels is not None:
        cells = [label(cell, text) for cell, text in zip(cells, labels, strict=True)]
    columns = min(columns, len(cells))
    rows, (h, w) = -(-len(cells) // columns), cells[0].shape[:2]
    sheet = np.full((rows * (h + gap) - gap, columns * (w + gap) - gap, 3), 255, np.uint8)
    for i, cell in enumerate(cells):
        y, x = (i // columns) * (h + gap), (i % columns) * (w + gap)
        sheet[y : y + h, x : x + w] = cell
    return sheet
