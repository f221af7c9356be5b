"""The sequence record: round trip and refusals; reading a user's JSON."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from soar.datasets.cameras import read_json_strictly
from soar.datasets.sequence import Sequence, Source, Subject, read_calibrated
from soar.errors import ArtifactError, CalibrationError, ConfigError
from soar.geometry.cameras import Camera


def camera(name: str) -> Camera:
    return Camera(name, 64, 48, np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), np.eye(4), np.zeros(5), "test")


RECORD = Sequence(
    name="walk-1",
    fps=30.0,
    frame_ids=(0, 2, 4),
    up=np.array([0.0, 0.0, 3.0]),
    train=("b",),
    eval=("a",),
    cameras=(camera("b"), camera("a")),
    sources=(Source("b", "b.mp4", "0" * 64),),
    subject=Subject((3.0, 4.0), None, 1, 1.8, "b"),
    remarks=("assumed",),
)


def test_round_trip(tmp_path):
    path = tmp_path / "sequence.json"
    RECORD.write(path)
    back = Sequence.read(path)
    assert len(back) == 3
    assert back.names == ("b", "a")
    assert back.camera("a").to_json() == camera("a").to_json()
    np.testing.assert_array_equal(back.up, (0, 0, 1))
    for field in ("name", "fps", "frame_ids", "train", "eval", "sources", "subject", "remarks"):
        assert getattr(back, field) == getattr(RECORD, field), field


def test_unknown_camera():
    with pytest.raises(ArtifactError, match="no camera 'c'"):
        RECORD.camera("c")


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"frame_ids": ()}, ArtifactError),
        ({"frame_ids": (0, 0)}, ArtifactError),
        ({"fps": 0.0}, ArtifactError),
        ({"fps": float("nan")}, ArtifactError),
        ({"name": "a/b"}, ArtifactError),
        ({"up": np.zeros(3)}, CalibrationError),
        ({"train": ()}, ConfigError),
        ({"train": ("c",)}, ConfigError),
        ({"eval": ("b",)}, ConfigError),
        ({"subject": Subject(None, None, 3, None, "b")}, ArtifactError),
    ],
)
def test_refusals(change, error):
    with pytest.raises(error):
        dataclasses.replace(RECORD, **change)


def test_malformed_file(tmp_path):
    path = tmp_path / "sequence.json"
    RECORD.write(path)
    value = json.loads(path.read_text())
    del value["fps"]
    path.write_text(json.dumps(value))
    with pytest.raises(ArtifactError, match="fps"):
        Sequence.read(path)


def test_refined_cameras(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"cameras": [camera("b").to_json()]}))
    assert read_calibrated(path, "b").to_json() == camera("b").to_json()
    with pytest.raises(ArtifactError, match="no camera 'c'"):
        read_calibrated(path, "c")
    path.write_text("[]")
    with pytest.raises(ArtifactError, match="no camera 'b'"):
        read_calibrated(path, "b")


def test_strict_json(tmp_path):
    path = tmp_path / "a.json"
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_json_strictly(path)
    path.write_text('{"cameras": {"a": 1, "a": 2}}')
    with pytest.raises(CalibrationError, match="a stands twice"):
        read_json_strictly(path)
    path.write_text("{")
    with pytest.raises(CalibrationError, match="not usable JSON"):
        read_json_strictly(path)
    path.write_text('{"a": 1}')
    assert read_json_strictly(path) == {"a": 1}
