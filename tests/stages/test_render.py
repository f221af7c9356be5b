"""Videos of the avatar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from soar.health import Health
from soar.stages import Job, render, views
from tests.report import toy
from tests.report.test_video import read_video


@pytest.mark.parametrize("pose", ["frame", "canonical"])
def test_turntable_shows_seen_front_and_unseen_back(tmp_path: Path, pose: str) -> None:
    inputs = toy.write_sequence(tmp_path)
    outputs = {"turntable": tmp_path / "t.webm", "evidence": tmp_path / "e.jpg", "health": tmp_path / "h.json"}
    cfg = toy.cfg("render", "raster")
    cfg["render"]["turntable"] |= {"pose": pose, "frames": 8, "height": 128, "fps": 12}
    render.run(inputs, outputs, cfg, Job("toy", None, 0, 1, tmp_path / "scratch"))
    frames, fps = read_video(outputs["turntable"])
    assert len(frames) == 8
    assert fps == pytest.approx(12, rel=0.01)
    panel = frames.shape[2] // 3
    assert frames.shape[1] == 128
    body = [f[58:70, 2 * panel + panel // 2 - 4 : 2 * panel + panel // 2 + 4].mean((0, 1)) for f in frames]
    redness = np.array([colour[0] - colour[1] for colour in body])
    assert redness[0] < 40  # the front was seen
    assert redness[4] > 120  # the back was not
    normals = frames[0][64, panel + panel // 2].astype(int)
    assert normals[2] > 220  # faces the camera: blue
    health = Health.read(outputs["health"]).numbers
    assert health["frames"]["value"] == 8
    assert health["crack_share"]["value"] < 0.02
    assert outputs["evidence"].stat().st_size > 1000


@pytest.mark.parametrize(("most", "count", "fps"), [(300, 4, 10.0), (2, 2, 5.0)])
def test_a_camera_video_has_the_rate_of_the_clip(tmp_path: Path, most: int, count: int, fps: float) -> None:
    inputs = toy.write_sequence(tmp_path)
    inputs["crops"] = inputs["crops"] / "front.npz"
    cfg = toy.cfg("render", "raster")
    cfg["render"]["views"] |= {"max_frames": most}
    views.run(inputs, {"view": tmp_path / "front.webm"}, cfg, Job("toy", "front", 0, 1, tmp_path / "scratch"))
    frames, rate = read_video(tmp_path / "front.webm")
    assert frames.shape == (count, 64, 192, 3)
    assert rate == pytest.approx(fps, rel=0.01)
    photograph, ours = frames[0][:, :64].astype(int), frames[0][:, 64:128].astype(int)
    assert np.abs(photograph[20:40, 28:36] - ours[20:40, 28:36]).mean() < 8
    assert photograph[:5, :5].mean() < 100  # the photograph keeps its background
    assert ours[:5, :5].mean() > 245
