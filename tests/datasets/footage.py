"""Small synthetic recordings, captures and calibrations for the dataset tests."""

from __future__ import annotations

import copy
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from soar.datasets import adapter
from soar.datasets.capture import Adapter
from tests.conftest import conf

WIDTH, HEIGHT = 96, 64


def picture(index: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(H, W, 3) RGB frame whose grey level tells its number, with a red square in the top-left corner."""
    image = np.full((height, width, 3), 40 + 7 * index, np.uint8)
    image[: height // 4, : width // 4] = (230, 20, 20)
    return image


def frame_number(image: np.ndarray) -> int:
    """The number :func:`picture` was made with, read from the bottom-right corner."""
    return round((float(image[-8:, -8:].mean()) - 40) / 7)


def write_video(
    path: Path, count: int, size: tuple[int, int] = (WIDTH, HEIGHT), fps: float = 30, code: str = "MJPG"
) -> Path:
    """Write ``count`` numbered frames."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), fps, size)
    assert writer.isOpened()
    for index in range(count):
        writer.write(np.ascontiguousarray(picture(index, *size)[..., ::-1]))
    writer.release()
    return path


def turn(path: Path) -> None:
    """Write "show me rotated by 90 degrees clockwise" into the track header of an .mp4."""
    data = bytearray(path.read_bytes())
    matrix = data.find(b"tkhd") + 44
    assert struct.unpack(">9i", data[matrix : matrix + 36]) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    data[matrix : matrix + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, HEIGHT << 16, 0, 1 << 30)
    path.write_bytes(data)


def write_images(folder: Path, numbers: list[int], size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    """Write a folder of numbered images; unpadded numbers, so that sorting by name would be wrong."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, number in enumerate(numbers):
        cv2.imwrite(str(folder / f"take2_{number}.png"), picture(index, *size)[..., ::-1])
    return folder


def node(option: str, **changes: Any) -> dict[str, Any]:
    """``conf/dataset/<option>.yaml`` with changes; ``frames__stride=2`` sets a field of a nested node."""
    value = copy.deepcopy(conf("dataset", option))
    for key, change in changes.items():
        *parents, last = key.split("__")
        place = value
        for parent in parents:
            place = place[parent]
        assert last in place
        place[last] = change
    return value


def open_adapter(option: str, **changes: Any) -> Adapter:
    """The adapter of :func:`node`, with a minimum clip length that suits small recordings."""
    return adapter(node(option, **({"frames__min_frames": 2} | changes)))


def camera_entry(distance: float = 4.0, size: tuple[int, int] = (WIDTH, HEIGHT), **changes: Any) -> dict[str, Any]:
    """One camera of the calibration schema: looks along +y of a z-up world from ``distance`` metres."""
    T = np.eye(4)
    T[:3, :3], T[2, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], distance
    value = {"size": list(size), "K": [100.0, 101.0, size[0] / 2, size[1] / 2], "T_cam_from_world": T.tolist()}
    return value | changes


def write_capture(folder: Path, cameras: dict[str, dict[str, Any]], count: int = 6, **changes: Any) -> Path:
    """A capture folder with one numbered video per camera and ``calibration.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, entry in cameras.items():
        write_video(folder / f"{name}.avi", count, tuple(entry["size"]))
    (folder / "calibration.json").write_text(
        json.dumps({"units": "metres", "up": [0, 0, 1], "cameras": cameras} | changes)
    )
    return folder
