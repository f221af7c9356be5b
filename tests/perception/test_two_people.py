"""Two people walk past each other: whoever is chosen is followed, and is alone in the masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import ImageArchive, write_images
from soar.body.openpose import INDEX
from soar.datasets.sequence import Sequence, Subject
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.perception.keypoints import Keypoints
from soar.stages import Job, keypoints, masks
from tests.conftest import ROOT, conf, model_file
from tests.perception.crossing import Clip, two_people

COUNT, WIDTH, HEIGHT = 20, 640, 360


@pytest.fixture(scope="module")
def clip() -> Clip:
    for name in ("pose_detection.onnx", "pose_landmark_full.onnx", "hand_landmark_full.onnx", "face_landmark.onnx"):
        model_file(name)
    return two_people((2, 5), COUNT, 10.0, (WIDTH, HEIGHT))


@pytest.mark.parametrize("who", [0, 1], ids=["in front", "behind"])
def test_the_chosen_one_is_kept_and_the_other_one_left_out(clip: Clip, tmp_path: Path, who: int) -> None:
    own, other, whole = clip.visible[who] > 0.5, clip.visible[1 - who] > 0.5, clip.whole[who] > 0.5
    record, found = _run(clip, tmp_path, _middle(own[0]))
    share = own.sum((1, 2)) / whole.sum((1, 2))
    assert share.min() > 0.99 if who == 0 else share.min() < 0.4
    assert record.present[share > 0.75].all()
    assert not record.present[share < 0.5].any()

    hips = record.keypoints[record.present, INDEX["mid_hip"], 0]
    assert abs(hips - [_middle(mask)[0] for mask in whole[record.present]]).max() < 20
    for t in np.flatnonzero(record.present):
        points = record.keypoints[t, :25]
        x, y = np.floor(points[points[:, 2] > 0.5, :2]).astype(int).T
        assert whole[t, y.clip(0, HEIGHT - 1), x.clip(0, WIDTH - 1)].mean() > 0.75, t

    for t, mask in enumerate(found):
        inside = mask > 127
        assert (inside & other[t]).sum() <= 0.01 * other[t].sum(), t
        assert inside.any() == record.present[t]
        if record.present[t]:
            assert (inside & own[t]).sum() > 0.8 * (inside | own[t]).sum(), t


def _middle(mask: np.ndarray) -> tuple[float, float]:
    """Middle of the box around a mask's pixels."""
    y, x = np.nonzero(mask)
    return (x.min() + x.max()) / 2, (y.min() + y.max()) / 2


def _run(clip: Clip, folder: Path, point: tuple[float, float]) -> tuple[Keypoints, list[np.ndarray]]:
    """The stages keypoints and masks on the clip."""
    write_images(folder / "frames.zip", clip.frames, ".png")
    camera = Camera("a", WIDTH, HEIGHT, np.diag([600.0, 600, 1]), np.eye(4), np.zeros(5), "test")
    subject = Subject(tuple(float(v) for v in point), None, 0, None, "a")
    Sequence("two", 10.0, tuple(range(COUNT)), np.array([0, 0, 1.0]), ("a",), (), (camera,), (), subject, ()).write(
        folder / "sequence.json"
    )
    inputs = {"sequence": folder / "sequence.json", "frames": folder / "frames.zip", "models": ROOT / "data" / "models"}
    job = Job("two", "a", 0, 1, folder)
    outputs = {"keypoints": folder / "a.npz", "evidence": folder / "k.jpg", "health": folder / "k.json"}
    keypoints.run(inputs, outputs, {"keypoints": conf("keypoints", "mediapipe")}, job)
    outputs = {"masks": folder / "a.zip", "evidence": folder / "m.jpg", "health": folder / "m.json"}
    masks.run(inputs | {"keypoints": folder / "a.npz"}, outputs, {"masks": conf("masks", "mediapipe")}, job)
    record, remarks = Keypoints.read(folder / "a.npz"), Health.read(folder / "k.json").remarks
    assert any("somebody else was near" in remark for remark in remarks) == (not record.present.all())
    return record, list(ImageArchive(folder / "a.zip"))
