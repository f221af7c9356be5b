"""Windows around the person: one size per camera, following the person, free to leave the image."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from soar.datasets.ingest import resample
from soar.errors import SubjectError
from soar.geometry.cameras import Camera


@dataclasses.dataclass(frozen=True)
class CropSettings:
    """Working resolution and windows.

    Attributes:
        long_side: longest side of a whole frame at working resolution, pixels.
        margin: free room on each side of the person, in units of the longer side of the person's box.
        multiple: window sides are multiples of this, pixels.
        threshold: mask value in [0, 1] from which a pixel counts as the person.
        min_run: such pixels a row or column needs to count.
    """

    long_side: int
    margin: float
    multiple: int
    threshold: float
    min_run: int


@dataclasses.dataclass(frozen=True)
class Windows:
    """Where the person is cut out.

    Attributes:
        rect: (T, 4) int32 x0, y0, width, height in working-scale pixels; one size for all.
        frame_index: (T,) int64 the frames that show the person, as positions in the clip.
        frames: length of the clip.
        cut_off: how many of the T frames show the person cut off by the image's border.
    """

    rect: np.ndarray
    frame_index: np.ndarray
    frames: int
    cut_off: int

    def camera(self, working: Camera, index: int) -> Camera:
        """The camera of window ``index``, from the camera at working scale."""
        return working.cropped(*map(int, self.rect[index]))


def person_rows_columns(mask: np.ndarray, threshold: float, min_run: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a (H, W) uint8 mask that hold at least ``min_run`` pixels of the person, increasing."""
    inside = mask >= threshold * 255.0
    return tuple(np.flatnonzero(np.count_nonzero(inside, axis=axis) >= min_run) for axis in (1, 0))


def find_windows(masks: Iterable[np.ndarray], working: Camera, settings: CropSettings) -> Windows:
    """Choose the windows of one camera, reading one mask at a time.

    Args:
        masks: (H, W) uint8 soft masks of all frames at full size.
        working: the camera at working scale; only its size is used.
        settings: see :class:`CropSettings`.

    Raises:
        SubjectError: no mask shows a person.
    """
    boxes, index, count, cut_off = [], [], 0, 0
    for count, mask in enumerate(masks, start=1):
        small = resample(mask, working.width, working.height)
        rows, columns = person_rows_columns(small, settings.threshold, settings.min_run)
        if rows.size and columns.size:
            boxes.append((columns[0], rows[0], columns[-1] + 1, rows[-1] + 1))
            index.append(count - 1)
            touches = columns[0] == 0 or rows[0] == 0
            cut_off += bool(touches or columns[-1] + 1 == working.width or rows[-1] + 1 == working.height)
    if not boxes:
        raise SubjectError(
            f"camera {working.name}: no frame shows a person",
            expected=f"a mask above {settings.threshold} in some of {count} frames",
            cure="look at the evidence of the masks; point at the person with dataset.subject, or drop this camera",
        )
    rect = place_windows(np.array(boxes), settings.margin, settings.multiple)
    return Windows(rect, np.array(index, np.int64), count, cut_off)


def place_windows(boxes: np.ndarray, margin: float, multiple: int) -> np.ndarray:
    """(T, 4) int32 x0, y0, width, height of equal windows centred on (T, 4) integer boxes x0, y0, x1, y1.

    The size is the largest box with its margins, rounded up to the multiple, so no box is ever cut.
    """
    sides = boxes[:, 2:] - boxes[:, :2]
    needed = (sides + 2.0 * margin * sides.max(axis=1, keepdims=True)).max(axis=0)
    size = (np.ceil(needed / multiple) * multiple).astype(np.int32)
    corner = np.floor((boxes[:, :2] + boxes[:, 2:] - size) / 2.0).astype(np.int32)
    return np.concatenate([corner, np.broadcast_to(size, corner.shape)], axis=1)


def cut(image: np.ndarray, rect: np.ndarray) -> np.ndarray:
    """The window (4,) x0, y0, width, height of a (H, W) or (H, W, 3) image; zero outside the image."""
    x0, y0, width, height = map(int, rect)
    out = np.zeros((height, width, *image.shape[2:]), image.dtype)
    top, left = max(y0, 0), max(x0, 0)
    part = image[top : max(y0 + height, 0), left : max(x0 + width, 0)]
    out[top - y0 : top - y0 + part.shape[0], left - x0 : left - x0 + part.shape[1]] = part
    return out


def border_share(alpha: np.ndarray) -> float:
    """Share of a (T, H, W) uint8 mask's mass that lies on the outermost pixels: the person the windows cut off."""
    inner = total = 0
    for frame in alpha:
        total += int(frame.sum(dtype=np.int64))
        inner += int(frame[1:-1, 1:-1].sum(dtype=np.int64))
    return (total - inner) / total if total else 0.0
