"""The three stages on a miniature recording of the stickman: files in, files and figures out."""

import json
from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import write_images
from soar.body import measure
from soar.body.motion import BodyMotion
from soar.body.openpose import BODY
from soar.datasets.sequence import Sequence, Subject, read_calibrated
from soar.errors import ArtifactError
from soar.health import Health
from soar.perception.keypoints import Keypoints
from soar.perception.mapping import SOURCES
from soar.perception.pose import INDEX as BLAZE
from soar.stages import Job, body, calibrate, monocular
from tests.body import stickman
from tests.body.test_calibrate import turned
from tests.conftest import conf

FRAMES = 4


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> dict[str, Path]:
    """Inputs of the stages: four cameras, of which the stored calibration of one is half a degree off."""
    root = tmp_path_factory.mktemp("recording")
    model = stickman.body()
    motion = stickman.motion(model, FRAMES)
    views = stickman.cameras(4, (240, 320))
    seen = stickman.observe(model, motion, views, noise_px=0.2)
    subject = Subject(point=None, box=None, frame=0, stature_m=None, camera="cam0")
    given = (views[0], turned(views[1], 0.7, 1), *views[2:])
    Sequence(
        name="dance", fps=30.0, frame_ids=tuple(range(FRAMES)), up=np.array([0, 0, 1.0]), train=("cam0",),
        eval=("cam1", "cam2", "cam3"), cameras=given, sources=(), subject=subject, remarks=(),
    ).write(root / "sequence.json")  # fmt: skip
    for c, camera in enumerate(views):
        points = np.concatenate([seen.points[c], seen.confidence[c][..., None]], -1)
        world = np.zeros((FRAMES, 33, 3))
        for i, name in enumerate(BODY):
            sources = SOURCES.get(name, (name,))
            if len(sources) == 1:
                world[:, BLAZE[sources[0]]] = seen.world[c][:, i]
        shape = (FRAMES, 4)
        record = Keypoints(points, world, np.ones(shape), np.ones(FRAMES), np.zeros((FRAMES, 25)))
        record.write(root / f"keypoints/{camera.name}.npz")
        inside = [measure.body_mask(camera, measure.frame_vertices(model, motion, t), model) for t in range(FRAMES)]
        write_images(root / f"masks/{camera.name}.zip", (255 * m.astype(np.uint8) for m in inside), ".png")
        write_images(root / f"frames/{camera.name}.zip", (np.full((320, 240, 3), 90, np.uint8) for _ in inside), ".jpg")
    model.to(dtype=stickman.torch.float32).save(root / "anny.npz")
    inputs = {name: root / name for name in ("keypoints", "masks", "frames")}
    return {**inputs, "sequence": root / "sequence.json", "body_model": root / "anny.npz"}


def run(stage, recording, folder, product, **cfg):
    outputs = {"health": folder / "health.json", "evidence": folder / "evidence.jpg", **product}
    stage.run(recording, outputs, cfg, Job("dance", None, 0, 1, folder))
    assert outputs["evidence"].stat().st_size > 5000
    return {name: entry["value"] for name, entry in Health.read(outputs["health"]).numbers.items()}


def test_calibrate_body_and_monocular(recording, tmp_path):
    inputs = dict(recording)
    options = {**conf("calibrate", "default"), "min_points": 20}
    inputs["calibration"] = tmp_path / "calibration.json"
    numbers = run(calibrate, inputs, tmp_path / "a", {"calibration": inputs["calibration"]}, calibrate=options)
    assert numbers["residual_after"] < numbers["residual_before"]
    record = json.loads(inputs["calibration"].read_text())
    assert record["applied"]
    assert record["original"][1]["T_cam_from_world"] != record["cameras"][1]["T_cam_from_world"]
    assert read_calibrated(inputs["calibration"], "cam1").name == "cam1"

    node = {**conf("body", "cpu"), "iterations": 60}
    node["silhouette"] = {**node["silhouette"], "rounds": 1, "iterations": 10, "scale": 1.0}
    nodes = {"body": node, "monocular": conf("monocular", "default")}
    inputs["reference"] = tmp_path / "body.npz"
    numbers = run(
        body, inputs, tmp_path / "b", {"body": inputs["reference"], "cameras": tmp_path / "cameras.json"}, **nodes
    )
    assert numbers["reprojection_limbs"] < 1.5
    assert numbers["overlap"] > 0.85
    assert numbers["overlap/cam3"] > 0.8
    assert len(BodyMotion.read(inputs["reference"])) == FRAMES

    assert read_calibrated(tmp_path / "cameras.json", "cam3").name == "cam3"
    assert numbers["turned/cam1"] < 1.0
    numbers = run(
        monocular,
        inputs,
        tmp_path / "m",
        {"body": tmp_path / "m.npz"},
        **nodes,
    )
    assert numbers["mpjpe"] < 6
    assert numbers["mpjpe_procrustes"] <= numbers["mpjpe"]
    assert abs(numbers["depth_bias"]) < 40


def test_archives_of_another_length_are_refused(recording, tmp_path):
    inputs = dict(recording, masks=tmp_path)
    inputs["calibration"] = tmp_path / "calibration.json"
    options = {**conf("calibrate", "default"), "min_points": 20}
    run(calibrate, inputs, tmp_path / "a", {"calibration": inputs["calibration"]}, calibrate=options)
    for c in range(4):
        write_images(tmp_path / f"cam{c}.zip", [np.zeros((320, 240), np.uint8)], ".png")
    with pytest.raises(ArtifactError, match="does not belong to this sequence"):
        run(body, inputs, tmp_path / "b", {"body": tmp_path / "b.npz"}, body=conf("body", "cpu"), monocular={})
