"""Video round trips."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from soar.errors import ArtifactError
from soar.report.video import write_video


def read_video(path: Path) -> tuple[np.ndarray, float]:
    """All frames (T, H, W, 3) RGB uint8 of a video, and its frame rate."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while (read := capture.read())[0]:
        frames.append(read[1][..., ::-1])
    return np.stack(frames), capture.get(cv2.CAP_PROP_FPS)


def ramp(t: int, height: int = 48, width: int = 64) -> np.ndarray:
    """A flat frame whose brightness tells its index."""
    return np.full((height, width, 3), 40 + 15 * t, np.uint8)


def test_frames_come_back_in_order_and_number(tmp_path: Path) -> None:
    assert write_video(tmp_path / "v.webm", (ramp(t) for t in range(12)), 12.5) == 12
    frames, fps = read_video(tmp_path / "v.webm")
    assert frames.shape == (12, 48, 64, 3)
    assert fps == pytest.approx(12.5, rel=0.01)
    assert np.abs(frames.mean((1, 2, 3)) - [40 + 15 * t for t in range(12)]).max() < 6


def test_is_a_webm_container(tmp_path: Path) -> None:
    write_video(tmp_path / "v.webm", [ramp(0)], 10)
    head = (tmp_path / "v.webm").read_bytes()[:64]
    assert head[:4] == b"\x1a\x45\xdf\xa3"
    assert b"webm" in head


def test_red_stays_red(tmp_path: Path) -> None:
    red = np.zeros((32, 32, 3), np.float32)
    red[..., 0] = 1.0
    write_video(tmp_path / "v.webm", [red] * 3, 10)
    r, g, b = read_video(tmp_path / "v.webm")[0].mean((0, 1, 2))
    assert r > 230
    assert g < 25
    assert b < 25


def test_odd_sizes_are_padded(tmp_path: Path) -> None:
    write_video(tmp_path / "v.webm", [ramp(1, 31, 45)] * 2, 10)
    assert read_video(tmp_path / "v.webm")[0].shape == (2, 32, 46, 3)


def test_a_failing_source_leaves_nothing(tmp_path: Path) -> None:
    def source():
        yield ramp(0)
        raise RuntimeError("source broke")

    with pytest.raises(RuntimeError, match="source broke"):
        write_video(tmp_path / "v.webm", source(), 10)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "frames", "message"),
    [
        ("v.webm", [], "no frame"),
        ("v.mp4", [ramp(0)], ".webm"),
        ("v.webm", [ramp(0), ramp(0, 24, 24)], "frame 2"),
    ],
)
def test_unusable_frames_are_named(tmp_path: Path, name: str, frames: list, message: str) -> None:
    with pytest.raises(ArtifactError, match=message):
        write_video(tmp_path / name, frames, 10)
    assert list(tmp_path.iterdir()) == []
