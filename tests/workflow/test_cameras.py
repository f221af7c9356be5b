"""A capture of several calibrated cameras through every stage by hand, one of them calibrated wrongly.

Real footage, cut to a few small frames; the graph of such a dataset is tested with stand-ins in ``test_dag``.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from soar.artifacts import ImageArchive, read_json, read_npz, sha256_file, write_npz
from soar.body.calibrate import angle_between
from soar.cli import main
from soar.datasets.calibration import parse_calibration
from soar.datasets.qualisys import read_qualisys
from soar.datasets.recordings import VideoFile
from soar.datasets.sequence import Sequence
from soar.workflow import STAGES, Workflow
from tests.conftest import ROOT, model_file

DEMO = ROOT / "data" / "datasets" / "demo"
CAMERAS = ("cam01", "cam02", "cam03")  # two see the front, the last one the back
TRAIN, EVAL = ("cam02",), ("cam03", "cam01")
FRAMES = range(10, 90, 14)
HEIGHT = 480  # of 1920 pixels
TURN_DEG = 1.6
OPTIONS = [
    "dataset=cameras",
    "dataset.path=capture",
    f"dataset.train=[{','.join(TRAIN)}]",
    f"dataset.eval=[{','.join(EVAL)}]",
    "dataset.frames.min_frames=4",
    "body.initial.iterations=60",
    "body.iterations=30",
    "body.silhouette.rounds=1",
    "body.silhouette.iterations=10",
    "avatar.subdivisions=0",
    "reconstruct.steps=10",
    "occlusion.steps=20",
    "refine.shape.steps=1",
    "refine.texture.steps=2",
    "render.turntable.frames=4",
    "evaluate.every=4",
]
RESULTS = Path("results/cameras/capture/full")


def write_capture(folder: Path) -> None:
    """The layout of docs/data.md: two folders of images, a video, and a calibration in which cam03 is turned."""
    published = parse_calibration(read_qualisys(DEMO / "Calib.qca.txt"), "Calib.qca.txt")
    entries = {}
    for name in CAMERAS:
        clip = VideoFile(DEMO / f"{name}.mp4")
        # The recorded image lacks the last columns of the calibrated one; then both shrink alike.
        recorded = dataclasses.replace(published.cameras[name], width=clip.probe.width, height=clip.probe.height)
        camera = recorded.resized(round(clip.probe.width * HEIGHT / clip.probe.height), HEIGHT)
        size = camera.width, camera.height
        images = [cv2.resize(image, size, interpolation=cv2.INTER_AREA)[..., ::-1] for image in clip.frames(FRAMES)]
        if name == "cam01":
            write_video(folder / f"{name}.avi", images, size)
        else:
            (folder / name).mkdir(parents=True)
            for number, image in zip(FRAMES, images, strict=True):
                cv2.imwrite(str(folder / name / f"frame_{number}.png"), image)
        T = camera.T_cam_from_world
        if name == "cam03":
            T = np.eye(4)
            T[:3, :3] = cv2.Rodrigues(np.radians(TURN_DEG) * np.array([0.3, 0.95, 0.0]))[0]
            T = T @ camera.T_cam_from_world
        entries[name] = {
            "size": [camera.width, camera.height],
            "K": camera.K.tolist(),
            "distortion": camera.distortion.tolist(),
            "T_cam_from_world": T.tolist(),
        }
    calibration = {"units": "metres", "up": [0, 0, 1], "fps": 60 / FRAMES.step, "cameras": entries}
    (folder / "calibration.json").write_text(json.dumps(calibration))


def write_video(path: Path, images: list[np.ndarray], size: tuple[int, int]) -> None:
    """(H, W, 3) BGR frames as one motion JPEG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 60 / FRAMES.step, size)
    assert writer.isOpened()
    for image in images:
        writer.write(np.ascontiguousarray(image))
    writer.release()


def run(stage: str, camera: str | None = None) -> int:
    """``python -m soar STAGE`` in this process, whose start costs more than most of these stages."""
    return main([stage, *OPTIONS, "--threads", "1", *(["--camera", camera] if camera else [])])


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Every stage in the order of the table, as a user without snakemake would run them."""
    model_file("manifest.json")
    if not (DEMO / "cam03.mp4").exists():
        pytest.skip("the demo footage is not there; `make demo` brings it")
    folder = tmp_path_factory.mktemp("cameras")
    write_capture(folder / "capture")
    (folder / "data").mkdir()
    (folder / "data" / "models").symlink_to(ROOT / "data" / "models")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in ("OMP", "MKL", "OPENBLAS"):
            patch.setenv(f"{name}_NUM_THREADS", "1")  # the command line sets them; so they are put back
        patch.setenv("OPENCV_FOR_THREADS_NUM", "1")
        flow = Workflow({"overrides": OPTIONS})
        for name, stage in ((name, STAGES[name]) for name in flow.stages("capture")):
            cameras = (TRAIN if stage.cameras == "train" else CAMERAS) if stage.per_camera else (None,)
            for camera in cameras:
                assert run(name, camera) == 0, (name, camera)
        assert run("report") == 0
        yield folder / RESULTS


def test_the_split_and_the_cameras_are_those_of_the_files(finished: Path) -> None:
    sequence = Sequence.read(finished / "ingest" / "sequence.json")
    assert (sequence.train, sequence.eval) == (TRAIN, EVAL)
    assert sequence.names == (*TRAIN, *EVAL)
    assert sequence.frame_ids == tuple(range(len(FRAMES)))
    assert sequence.fps == pytest.approx(60 / FRAMES.step)
    for name in CAMERAS:
        frames = ImageArchive(finished / "frames" / f"{name}.zip")
        camera = sequence.camera(name)
        assert len(frames) == len(FRAMES)
        assert frames[0].shape == (camera.height, camera.width, 3)
        assert camera.height == HEIGHT
    assert [path.stem for path in (finished / "normals").glob("*.npz")] == list(TRAIN)


def test_the_wrong_rotation_is_found_and_undone(finished: Path) -> None:
    record = read_json(finished / "calibrate" / "calibration.json")
    assert record["applied"]
    residual = record["residual_px"]
    assert residual["per_camera_before"]["cam03"] > 6
    assert residual["per_camera_after"]["cam03"] < 2.5
    assert residual["robust_after"] < 1.3
    given = {entry["name"]: entry for entry in record["original"]}
    turned = {
        entry["name"]: np.degrees(angle_between(rotation(entry), rotation(given[entry["name"]])))
        for entry in record["cameras"]
    }
    assert max(turned, key=turned.__getitem__) == "cam03"
    assert turned["cam03"] == pytest.approx(TURN_DEG, abs=0.8)  # the published calibration is off by half a degree too


def rotation(entry: dict) -> np.ndarray:
    """(3, 3) of a stored camera."""
    return np.array(entry["T_cam_from_world"])[:3, :3]


def test_later_stages_use_the_refined_cameras(finished: Path) -> None:
    given = Sequence.read(finished / "ingest" / "sequence.json").camera("cam03")
    used = read_npz(finished / "crops" / "cam03.npz")["T_cam_from_world"]
    assert np.degrees(angle_between(used[:3, :3], given.R)) > 0.6
    np.testing.assert_allclose(-used[:3, :3].T @ used[:3, 3], given.centre, atol=1e-5)  # turned about its own centre
    numbers = {k: v["value"] for k, v in read_json(finished / "body" / "health.json")["numbers"].items()}
    assert numbers["overlap/cam03"] > 0.7
    assert numbers["reprojection_limbs"] < 3
    assert "mpjpe" in read_json(finished / "monocular" / "health.json")["numbers"]


def test_unseen_cameras_are_measured(finished: Path) -> None:
    cameras = read_json(finished / "evaluate" / "metrics.json")["cameras"]
    assert {name: camera["split"] for name, camera in cameras.items()} == {
        **dict.fromkeys(TRAIN, "train"),
        **dict.fromkeys(EVAL, "eval"),
    }
    for name in CAMERAS:
        ours = cameras[name]["methods"]["ours"]
        assert ours["iou"] > 0.7, name
        assert ours["psnr"] > 15, name
    train, unseen = cameras["cam02"]["methods"], cameras["cam03"]["methods"]
    assert train["ours"]["psnr"] > train["paint"]["psnr"]
    assert train["ours"]["occluded_mpsnr"] is None  # what the training camera shows was seen
    assert unseen["ours"]["occluded_mpsnr"] < train["ours"]["visible_mpsnr"]
    with open(finished / "evaluate" / "per_frame.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["camera"] for row in rows if row["split"] == "eval"} == set(EVAL)
    assert 0.2 < read_json(finished / "occlusion" / "occlusion.json")["bor"] < 0.6
    assert "cam03" in (finished.parents[1] / "report" / "report.html").read_text()


def test_evaluation_cameras_lend_no_colour(finished: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Black pictures in their crops change nothing of what is made."""
    copy = tmp_path / "project"
    shutil.copytree(finished.parents[3], copy, symlinks=True)
    monkeypatch.chdir(copy)
    for name in EVAL:
        path = RESULTS / "crops" / f"{name}.npz"
        arrays = read_npz(path)
        write_npz(path, arrays | {"rgb": np.zeros_like(arrays["rgb"])})
    for stage in ("paint", "reconstruct"):
        (RESULTS / stage / "avatar.safetensors").unlink()
        assert run(stage) == 0
        assert sha256_file(RESULTS / stage / "avatar.safetensors") == sha256_file(
            finished / stage / "avatar.safetensors"
        )
