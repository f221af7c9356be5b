"""The keypoint and mask stages on files, with stand-in providers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import ImageArchive, write_images
from soar.datasets.sequence import Sequence, Subject
from soar.errors import ArtifactError
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.perception.keypoints import Choice, Keypoints, TrackReport
from soar.stages import Job, keypoints, masks

COUNT, HEIGHT, WIDTH = 5, 120, 90


def _record(count: int = COUNT) -> Keypoints:
    points = np.zeros((count, 137, 3), np.float32)
    points[:, :25, 0] = 45 + 10 * np.sin(np.arange(25))
    points[:, :25, 1] = np.linspace(20, 100, 25)
    points[:, :25, 2] = 0.9
    roi = np.tile(np.array([45, 60, 100, 0], np.float32), (count, 1))
    score = np.full(count, 0.9, np.float32)
    points[1], roi[1], score[1] = 0, 0, 0.2
    return Keypoints(points, np.zeros((count, 33, 3)), roi, score, np.zeros((count, 25)))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    write_images(tmp_path / "a.zip", (rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8) for _ in range(COUNT)), ".jpg")
    cameras = tuple(
        Camera(name, WIDTH, HEIGHT, np.diag([100.0, 100, 1]), np.eye(4), np.zeros(5), "test") for name in ("a", "b")
    )
    subject = Subject((45.0, 60.0), None, 2, None, "a")
    ids = tuple(range(10, 10 + COUNT))
    Sequence("clip", 30.0, ids, np.array([0, 0, 1.0]), ("a",), ("b",), cameras, (), subject, ()).write(
        tmp_path / "sequence.json"
    )
    return tmp_path


def _run(stage, folder: Path, output: str, camera: str = "a") -> Health:
    files = {"sequence": "sequence.json", "frames": "a.zip", "models": "models", "keypoints": "k.npz"}
    inputs = {name: folder / file for name, file in files.items()}
    outputs = {output: inputs["keypoints"] if output == "keypoints" else folder / "m.zip"}
    outputs |= {"health": folder / "h.json", "evidence": folder / "e.jpg"}
    stage.run(inputs, outputs, {"keypoints": {}, "masks": {}}, Job("clip", camera, 0, 1, folder))
    assert outputs["evidence"].stat().st_size > 1000
    return Health.read(outputs["health"])


@pytest.mark.parametrize(("camera", "told"), [("a", Choice(2, (45.0, 60.0), None)), ("b", None)])
def test_keypoints(folder, monkeypatch, camera, told):
    asked = []

    def provider(node, files, threads, sequence, camera):
        def estimate(frames, choice):
            asked.append((len(frames), choice, files["models"].name, threads, sequence.name, camera))
            swapped = np.zeros((COUNT, 3), bool)
            swapped[3] = True
            return _record(), TrackReport(2, 0.1, 1, swapped, ("look here",))

        return estimate

    monkeypatch.setattr(keypoints, "keypoint_provider", provider)
    health = _run(keypoints, folder, "keypoints", camera)
    assert asked == [(COUNT, told, "models", 1, "clip", camera)]
    values = {name: entry["value"] for name, entry in health.numbers.items()}
    assert values["present"] == pytest.approx(0.8)
    assert values["score"] == pytest.approx(0.9)
    assert values["swaps_corrected"] == 1
    assert values["reacquired"] == 1
    assert "first being frame 11" in health.remarks[0]
    assert "exchanged in 1 of 5" in health.remarks[1]
    assert health.remarks[2] == "look here"
    assert Keypoints.read(folder / "k.npz").present.sum() == 4


def test_masks(folder, monkeypatch):
    def estimate(image, roi, body):
        assert roi.side == 100
        assert body.shape == (25, 3)
        alpha = np.zeros(image.shape[:2], np.float32)
        alpha[20:100, 30:60] = 0.8
        return alpha

    monkeypatch.setattr(masks, "mask_provider", lambda node, models, threads: estimate)
    _record().write(folder / "k.npz")
    health = _run(masks, folder, "masks")
    archive = ImageArchive(folder / "m.zip")
    assert len(archive) == COUNT
    assert archive[0].shape == (HEIGHT, WIDTH)
    assert archive[0][50, 40] == 204
    assert not archive[1].any()
    values = {name: entry["value"] for name, entry in health.numbers.items()}
    assert values == {"empty_frames": 0.2, "area": 2400, "area_jitter": 0, "components": 1, "border_contact": 0}
    assert "first being frame 11" in health.remarks[0]


def test_masks_of_other_frames(folder, monkeypatch):
    monkeypatch.setattr(masks, "mask_provider", lambda node, models, threads: None)
    _record(COUNT + 1).write(folder / "k.npz")
    with pytest.raises(ArtifactError, match="does not belong to these frames"):
        _run(masks, folder, "masks")
