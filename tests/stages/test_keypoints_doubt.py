"""Who the subject is, in doubt: the picture that is left for the user, and what the evidence shows of other people."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from soar.artifacts import write_images
from soar.datasets.sequence import Sequence, Subject
from soar.errors import SubjectError
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.perception.detector import Person
from soar.perception.keypoints import Keypoints, TrackReport
from soar.perception.roi import Roi
from soar.perception.subject import most_prominent
from soar.stages import Job, keypoints
from tests.perception.test_subject import OPTIONS

COUNT, WIDTH, HEIGHT = 9, 200, 120


def _run(folder: Path, monkeypatch: pytest.MonkeyPatch, estimate) -> dict[str, Path]:
    write_images(folder / "frames.zip", (np.full((HEIGHT, WIDTH, 3), 90, np.uint8) for _ in range(COUNT)), ".png")
    camera = Camera("a", WIDTH, HEIGHT, np.diag([100.0, 100, 1]), np.eye(4), np.zeros(5), "test")
    subject = Subject(None, None, 0, None, "a")
    Sequence("two", 10.0, tuple(range(COUNT)), np.array([0, 0, 1.0]), ("a",), (), (camera,), (), subject, ()).write(
        folder / "sequence.json"
    )
    monkeypatch.setattr(keypoints, "keypoint_provider", lambda *_: estimate)
    inputs = {name: folder / file for name, file in (("sequence", "sequence.json"), ("frames", "frames.zip"))}
    outputs = {name: folder / f"a.{file}" for name, file in (
        ("keypoints", "npz"), ("evidence", "evidence.jpg"), ("health", "health.json"))}  # fmt: skip
    keypoints.run(inputs | {"models": folder}, outputs, {"keypoints": {}}, Job("two", "a", 0, 1, folder))
    return outputs


def _record(hidden: int) -> Keypoints:
    points = np.zeros((COUNT, 137, 3))
    points[:, :25] = [100, 60, 0.9]
    points[:, 1, 1], points[:, 11, 1] = 20, 100
    roi, others = np.tile([100.0, 60, 100, 0], (COUNT, 1)), np.tile([150.0, 60, 100, 0, 1], (COUNT, 1, 1))
    points[hidden], roi[hidden] = 0, 0
    return Keypoints(points, np.zeros((COUNT, 33, 3)), roi, np.ones(COUNT), np.zeros((COUNT, 25)), others)


def test_equally_likely_people_leave_a_picture_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = [Person(0.9, Roi(60, 60, 80, 0.0)), Person(0.9, Roi(140, 60, 80, 0.0))]

    def estimate(frames, choice):
        return most_prominent([pair] * len(frames), WIDTH, HEIGHT, OPTIONS)

    with pytest.raises(SubjectError, match="equally likely") as error:
        _run(tmp_path, monkeypatch, estimate)
    picture = tmp_path / "a.doubt.jpg"
    assert str(picture) in error.value.got
    assert "[60,60]" in error.value.got
    assert {file.name for file in tmp_path.iterdir()} == {"frames.zip", "sequence.json", "a.doubt.jpg"}
    drawn = cv2.imread(str(picture))[..., ::-1].astype(int)
    red = (drawn[..., 0] - drawn[..., 1:].max(-1)) > 60
    assert red[:, 20:100].any() and red[:, 100:180].any()  # noqa: PT018
    assert red[60, 60]

    # Once the user has said who it is, the picture goes.
    report = TrackReport(0, 0.0, 0, np.zeros((COUNT, 3), bool), ())
    _run(tmp_path, monkeypatch, lambda frames, choice: (_record(4), report))
    assert not picture.exists()


def test_the_sheet_shows_frames_with_hidden_people_and_the_remark_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, labels = _record(hidden=6), []
    monkeypatch.setattr(keypoints, "grid", lambda pictures, columns, texts: labels.extend(texts) or pictures[0])
    report = TrackReport(0, 0.0, 0, np.zeros((COUNT, 3), bool), ())
    outputs = _run(tmp_path, monkeypatch, lambda frames, choice: (record, report))
    assert labels == ["frame 0", "frame 4", "frame 6  nobody", "frame 8"]
    health = Health.read(outputs["health"])
    assert any(remark.startswith("In 1 of them somebody else was near") for remark in health.remarks)
    assert "disagreement" not in health.numbers  # there was no second pass
    back = Keypoints.read(outputs["keypoints"])
    assert back.company.all()
    np.testing.assert_array_equal(back.others, record.others.astype(np.float32))
