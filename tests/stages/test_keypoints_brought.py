"""The keypoint stage with what users bring: OpenPose's files, networks with SimCC heads, boxes of YOLOX."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from soar.artifacts import write_images
from soar.body.openpose import BODY, INDEX
from soar.datasets import adapter
from soar.datasets.ingest import describe, stored_frames, undistort_points
from soar.errors import ConfigError, InputError, SubjectError
from soar.health import Health
from soar.perception import openpose_json, simcc
from soar.perception.keypoints import Keypoints
from soar.perception.wholebody import openpose_137
from soar.stages import Job, keypoints
from soar.workflow import Workflow
from tests.datasets.footage import node as dataset_node
from tests.perception.marionette import BOX, KnownPose, detector, dot_finder, frame, node, truth
from tests.perception.test_openpose_json import person, write

COUNT, FIRST = 8, 5
KEPT = [2, 3, 4, 5, 6, 7]  # positions in the recording
LENS = (-0.08, 0.01, 0.001, -0.001)
PEOPLE = np.stack([truth(t) for t in range(COUNT)])


def dataset(folder: Path, **changes: Any) -> dict[str, Any]:
    lens = {"intrinsics__K": [500.0, 500.0, 320.0, 240.0], "intrinsics__distortion": list(LENS)}
    frames = {"frames__start": 2, "frames__min_frames": 2, "frames__fps": 10.0, "frames__long_side": 320}
    return dataset_node("video", path=str(folder / "clip"), **{**lens, **frames, **changes})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Images numbered from 5, of which the last six are kept: without the lens's distortion, at half the size."""
    (tmp_path / "clip").mkdir()
    for t in range(COUNT):
        cv2.imwrite(str(tmp_path / "clip" / f"take1_{FIRST + t}.png"), frame(t, PEOPLE[t])[..., ::-1])
    _store(tmp_path)
    known = KnownPose(_stored(tmp_path, PEOPLE))
    for module in (openpose_json, simcc):
        monkeypatch.setattr(module, "PoseNetwork", lambda path, threads: known)
    return tmp_path


def _store(folder: Path, **changes: Any) -> None:
    capture = adapter(dataset(folder, **changes)).capture("clip")
    sequence = describe(capture)
    sequence.write(folder / "sequence.json")
    write_images(folder / "camera.zip", stored_frames(capture, sequence, "camera"), ".png")


def _stored(folder: Path, points: np.ndarray) -> np.ndarray:
    """Points of the recording where the stored frames show them."""
    camera = adapter(dataset(folder)).capture("clip").cameras[0]
    places = undistort_points(camera, points[..., :2].reshape(-1, 2)).reshape(*points.shape[:-1], 2) / 2
    return np.concatenate([places, points[..., 2:]], -1)


def run(folder: Path, options: dict[str, Any], **brought: Path) -> tuple[Keypoints, Health]:
    inputs = {"sequence": "sequence.json", "frames": "camera.zip", "models": "models"}
    outputs = {"keypoints": "k.npz", "health": "h.json", "evidence": "e.jpg"}
    paths = [{name: folder / file for name, file in files.items()} for files in (inputs, outputs)]
    keypoints.run(paths[0] | brought, paths[1], {"keypoints": options}, Job("clip", "camera", 0, 1, folder))
    assert paths[1]["evidence"].stat().st_size > 1000
    return Keypoints.read(paths[1]["keypoints"]), Health.read(paths[1]["health"])


def openpose_node(folder: Path, **changes: Any) -> dict[str, Any]:
    return node("openpose", dataset=dataset(folder), **changes)


def _write_openpose(folder: Path, first: int = FIRST, scale: float = 1.0, **people: np.ndarray) -> Path:
    """Files of all frames: somebody small at the left, and the person, in an order that changes."""
    target = folder / "json"
    for t in range(COUNT):
        ours = openpose_137(PEOPLE[t])
        theirs = ours * [0.3, 0.3, 1] + [10, 300, 0]
        both = [person(k * [scale, scale, 1]) for k in (ours, theirs)]
        write(target / f"take1_{first + t:012d}_keypoints.json", *(both if t % 3 else both[::-1]))
    return target


def test_openpose_files_of_the_recording_come_to_the_stored_frames(folder: Path) -> None:
    record, health = run(folder, openpose_node(folder), source=_write_openpose(folder))
    expected = openpose_137(_stored(folder, PEOPLE[KEPT]))
    assert record.keypoints.shape == (len(KEPT), 137, 3)
    # Middles of undistorted points and undistorted middles are not quite the same.
    np.testing.assert_allclose(record.keypoints, expected, atol=0.2)
    assert np.median(abs(record.keypoints - expected)) < 1e-3
    assert record.present.all()
    assert record.world.any((1, 2)).all()
    assert record.company.any()  # the small one's region meets
    assert health.numbers["present"]["value"] == 1
    assert "disagreement" not in health.numbers


def test_the_users_word_is_on_another_person(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = openpose_137(PEOPLE[2])[INDEX["mid_hip"], :2] * 0.3 + [10, 300]
    _store(folder, subject__point=[float(v) for v in small])
    known = KnownPose(_stored(folder, PEOPLE * [0.3, 0.3, 1] + [10, 300, 0]))
    monkeypatch.setattr(openpose_json, "PoseNetwork", lambda path, threads: known)
    record, _ = run(folder, openpose_node(folder), source=_write_openpose(folder))
    hips = record.keypoints[:, INDEX["mid_hip"], :2]
    assert np.linalg.norm(hips - _stored(folder, np.append(small, 1.0)[None])[0, :2], axis=1).max() < 5


def test_other_numbers(folder: Path) -> None:
    source = _write_openpose(folder, first=1000)
    with pytest.raises(InputError, match="no keypoints of these frames") as error:
        run(folder, openpose_node(folder), source=source)
    assert error.value.expected == "files numbered 7 to 12"
    assert error.value.got == "1000 to 1007"
    assert not (folder / "k.npz").exists()


def test_stored_frames_are_numbered_from_the_first(folder: Path) -> None:
    target = folder / "json"
    for i, k in enumerate(openpose_137(_stored(folder, PEOPLE[KEPT]))):
        write(target / f"f_{1 + i}_keypoints.json", person(k))
    options = openpose_node(folder, made_of="frames", first_number=1)
    record, _ = run(folder, options, source=target)
    np.testing.assert_allclose(record.keypoints[0], openpose_137(_stored(folder, PEOPLE[2])), atol=1e-4)


def test_gaps_are_frames_without_the_person(folder: Path) -> None:
    source = _write_openpose(folder)
    (source / f"take1_{FIRST + 4:012d}_keypoints.json").unlink()
    write(source / f"take1_{FIRST + 5:012d}_keypoints.json")  # nobody in it
    record, health = run(folder, openpose_node(folder), source=source)
    assert record.present.tolist() == [True, True, False, False, True, True]
    assert any("no file for 1 of 6 frames, the first being frame 4" in remark for remark in health.remarks)
    for t in (2, 3, 7):
        (source / f"take1_{FIRST + t:012d}_keypoints.json").unlink()
    with pytest.raises(SubjectError, match="too few frames"):
        run(folder, openpose_node(folder), source=source)


def test_keypoints_of_footage_of_another_size(folder: Path) -> None:
    with pytest.raises(InputError, match="outside of the recording") as error:
        run(folder, openpose_node(folder), source=_write_openpose(folder, scale=3.0))
    assert "keypoint_scale 0" in error.value.cure
    # Too small fits the picture, but not the person in it.
    with pytest.raises(InputError, match="do not lie on the person"):
        run(folder, openpose_node(folder), source=_write_openpose(folder, scale=0.5))


def test_body_alone_and_joints_that_were_not_found(folder: Path) -> None:
    source = folder / "json"
    for t in range(COUNT):
        k = openpose_137(PEOPLE[t])
        k[[INDEX["mid_hip"], INDEX["left_wrist"]]] = 0
        write(source / f"take1_{FIRST + t:012d}_keypoints.json", person(k, hands_and_face=False))
    record, _ = run(folder, openpose_node(folder), source=source)
    assert record.present.all()
    assert not record.keypoints[:, [INDEX["mid_hip"], INDEX["left_wrist"], *range(len(BODY), 137)]].any()
    hips = record.keypoints[:, [INDEX["left_hip"], INDEX["right_hip"]], :2].mean(1)
    np.testing.assert_allclose(record.roi[:, :2], hips, atol=1e-3)


def test_no_folder_is_named(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"keypoints\.source is not set"):
        run(folder, openpose_node(folder))


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = tmp_path_factory.mktemp("networks")
    # Stored frames are 320 x 240, and the detector's 640 x 640 pixels show them enlarged twice.
    return {"network": dot_finder(made / "dots.onnx"), "detector": detector(made / "yolox.onnx", [(*BOX, 0.9)])}


@pytest.mark.parametrize("option", ["rtmw", "dwpose"])
def test_a_simcc_network_with_boxes_of_yolox(folder: Path, networks: dict[str, Path], option: str) -> None:
    record, health = run(folder, node(option, device="cpu"), **networks)
    error = np.linalg.norm((record.keypoints - openpose_137(_stored(folder, PEOPLE[KEPT])))[..., :2], axis=-1)
    assert np.median(error) < 0.7
    assert np.quantile(error, 0.99) < 2.0  # dots are four pixels wide here
    assert record.present.all()
    assert health.numbers["disagreement"]["value"] < 0.03


@pytest.mark.parametrize("option", ["openpose", "rtmw", "dwpose"])
def test_the_workflow_depends_on_the_files(option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"openpose": ("source",), "rtmw": ("network",), "dwpose": ("network", "detector")}[option]
    paths = {name: tmp_path / ("{camera}" if name == "source" else f"{name}.onnx") for name in names}
    overrides = [f"keypoints.{name}='{path}'" for name, path in paths.items()]
    with pytest.raises(ConfigError, match=f"keypoints is given {names[0]}="):
        Workflow({"keypoints": option, "overrides": overrides})
    for camera in ("cam01", "cam02", "cam03", "cam04"):
        (tmp_path / camera).mkdir()
    for name in names:
        (tmp_path / f"{name}.onnx").touch()
    flow = Workflow({"keypoints": option, "overrides": overrides})
    inputs = flow.inputs("keypoints", "balance", "full", "cam02")
    assert {name: inputs[name] for name in names} == {
        name: str(path).replace("{camera}", "cam02") for name, path in paths.items()
    }
