"""Videos that browsers play, written with the VP8 encoder that OpenCV brings along."""

from __future__ import annotations

import os
from collections.abc import Iterable

import cv2
import numpy as np

from soar.artifacts import atomic_path
from soar.errors import ArtifactError, StorageError
from soar.report.pictures import to_uint8

MIME = "video/webm"


def write_video(path: str | os.PathLike[str], frames: Iterable[np.ndarray], fps: float) -> int:
    """Write frames, one at a time, to a VP8 ``.webm``.

    Args:
        path: file to write; its suffix must be ``.webm``.
        frames: (H, W, 3) RGB, uint8 or float in [0, 1], all of one size. VP8 stores colour at half resolution, so an
            odd size gains one repeated row or column.
        fps: frames per second of playback.

    Returns:
        the number of frames written.

    Raises:
        ArtifactError: there is no frame, the suffix is another one, or a frame differs in size from the first.
        StorageError: the encoder could not open or finish the file.
    """
    if not str(path).endswith(".webm"):
        raise ArtifactError(f"{path} cannot hold VP8 video", expected="a name ending in .webm")
    writer: cv2.VideoWriter | None = None
    size, count = (0, 0), 0
    with atomic_path(path) as temporary:
        try:
            for count, frame in enumerate(frames, start=1):
                picture = to_uint8(frame)
                height, width = picture.shape[:2]
                if writer is None:
                    size = (width, height)
                    even = (width + width % 2, height + height % 2)
                    writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"VP80"), fps, even)
                    if not writer.isOpened():
                        raise StorageError(f"cannot start video {path}", cure="check disk space and the OpenCV package")
                if (width, height) != size:
                    raise ArtifactError(
                        f"frame {count} of {path} changes size", expected=str(size), got=str((width, height))
                    )
                even_picture = cv2.copyMakeBorder(picture, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
                writer.write(np.ascontiguousarray(even_picture[..., ::-1]))
        finally:
            if writer is not None:
                writer.release()
        if writer is None:
            raise ArtifactError(f"there is no frame to write to {path}")
        if temporary.stat().st_size == 0:
            raise StorageError(f"the encoder left {path} empty", cure="free disk space, run again")
    return count
