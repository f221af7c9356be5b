"""What a dataset gives instead of an estimator: who refuses, what depends on it, and a miniature of all stages."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import ImageArchive, read_json, read_npz, read_tensors
from soar.body.motion import BodyMotion
from soar.cli import execute
from soar.datasets.planes import cropped_normals
from soar.errors import ArtifactError, ConfigError
from soar.health import Health
from soar.perception.keypoints import Keypoints
from soar.stages._subject import archive
from soar.workflow import STAGES, Workflow, folders, output_paths
from tests.conftest import model_file

NAME = "benchmark-0003-dance"
SMALL = (
    "dataset.first=3",
    "dataset.count=1",
    "dataset.frames.count=5",
    "dataset.frames.fps=2",
    "dataset.cameras.size=[128,144]",
    "dataset.cameras.eval=[180]",
    "dataset.people.render.subdivisions=0",
    "normals=dataset",
    "body.initial.iterations=20",  # of the one-camera check
    "body.iterations=10",
    "monocular.silhouette.rounds=1",
    "reconstruct.steps=3",
    "occlusion.steps=20",
    "refine.shape.steps=1",
    "refine.texture.steps=2",
    "render.turntable.frames=3",
)


# --- who refuses -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("group", ["masks", "keypoints", "body", "normals"])
def test_a_dataset_that_gives_nothing_refuses_by_name(group: str) -> None:
    with pytest.raises(ConfigError, match=f"{group}=dataset: the dataset demo gives no {group}") as caught:
        Workflow({group: "dataset"})
    assert f"choose one of those for {group}" in caught.value.cure
    assert "dataset" not in caught.value.expected


def test_truth_is_asked_of_footage_alone_in_vain() -> None:
    flow = Workflow({})
    assert not {"truth", "maps"} & set(flow.stages(flow.sequences[0]))


# --- who depends on it -----------------------------------------------------------------------------------------------


def uses(flow: Workflow, stage: str) -> set[str]:
    """Names of the stages whose files a stage reads."""
    sequence = flow.sequences[0]
    camera = flow.cameras(sequence)[0] if STAGES[stage].per_camera else None
    entries = flow.inputs(stage, sequence, "full", camera).values()
    paths = [path for entry in entries for path in ([entry] if isinstance(entry, str) else entry)]
    return {Path(path).parent.name for path in paths if path.startswith("results")}


def test_made_up_people_come_with_perfect_perception() -> None:
    flow = Workflow({"dataset": "synthetic"})
    config = flow.config("full")
    assert [config[g]["provider"] for g in ("keypoints", "masks", "body")] == ["dataset"] * 3
    assert config["normals"]["provider"] == Workflow({}).config("full")["normals"]["provider"] != "dataset"
    assert {"truth", "maps"} < set(flow.stages(flow.sequences[0]))
    assert "truth" in uses(flow, "keypoints") & uses(flow, "body")
    assert "maps" in uses(flow, "masks")
    for stage in STAGES.keys() - {"keypoints", "masks", "body", "truth", "maps"}:
        assert not {"truth", "maps"} & uses(flow, stage), stage


def test_only_stages_that_are_given_something_depend_on_it() -> None:
    flow = Workflow({"dataset": "synthetic", "masks": "mediapipe", "keypoints": "mediapipe", "body": "cpu"})
    assert all(not {"truth", "maps"} & uses(flow, stage) for stage in STAGES)
    assert {"truth", "maps"} < set(flow.stages(flow.sequences[0]))  # they are results all the same
    assert "maps" in uses(Workflow({"dataset": "synthetic", "normals": "dataset"}), "normals")


def test_a_given_body_keeps_the_settings_of_the_one_camera_check() -> None:
    given, fitted = (Workflow({"dataset": "synthetic", "body": b}).config("full")["body"] for b in ("dataset", "cpu"))
    assert given == fitted | {"provider": "dataset"}


# --- a miniature of all stages ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one sequence whose stages all ran, in one process."""
    model_file("body/anny_helpers.npz")
    folder = tmp_path_factory.mktemp("given")
    (folder / "data").mkdir()
    (folder / "data" / "models").symlink_to(model_file("manifest.json").parent)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        flow = Workflow({"dataset": "synthetic", "overrides": list(SMALL)})
        assert flow.sequences == [NAME]
        for job in flow.jobs():
            run(flow, job["stage"], job["camera"])
    return folder / "results" / "synthetic" / NAME / "full"


def run(flow: Workflow, stage: str, camera: str | None) -> None:
    """One job, as the DAG would start it."""
    (sequence,) = flow.sequences
    outputs = output_paths(STAGES[stage], flow.folder(stage, sequence, "full"), camera)
    for path in outputs.values():
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    execute(
        stage,
        {name: Path(path) for name, path in folders(flow.inputs(stage, sequence, "full", camera)).items()},
        {name: Path(path) for name, path in outputs.items()},
        flow.slice(stage, "full"),
        sequence=sequence,
        camera=camera,
        threads=1,
    )


def numbers(path: Path) -> dict[str, float]:
    return {name: entry["value"] for name, entry in Health.read(path).numbers.items()}


def test_the_stages_take_what_is_given(made: Path) -> None:
    known, used = BodyMotion.read(made / "truth" / "body.npz"), BodyMotion.read(made / "body" / "body.npz")
    np.testing.assert_array_equal(known.pose, used.pose)
    sequence, cameras = read_json(made / "ingest" / "sequence.json"), read_json(made / "body" / "cameras.json")
    assert cameras["cameras"] == sequence["cameras"]
    for camera in ("a000", "a180"):
        alpha, masks = (
            ImageArchive(made / "maps" / f"{camera}.zip", "alpha"),
            ImageArchive(made / f"masks/{camera}.zip"),
        )
        assert len(alpha) == len(masks) == 5
        np.testing.assert_array_equal(alpha[2], masks[2])
        assert Keypoints.read(made / "keypoints" / f"{camera}.npz").present.all()
    maps, crops = read_npz(made / "normals" / "a000.npz"), read_npz(made / "crops" / "a000.npz")
    picture = ImageArchive(made / "maps" / "a000.zip", "front")[1]
    front = cropped_normals(picture, float(crops["scale"]), crops["rect"][1])
    np.testing.assert_array_equal(maps["front"][1], np.round(127 * front))
    assert numbers(made / "body" / "health.json")["reprojection_all"] < 0.01
    assert numbers(made / "calibrate" / "health.json")["residual_after"] < 0.05
    assert numbers(made / "normals" / "a000.health.json")["coverage_iou"] > 0.97
    assert numbers(made / "maps" / "a180.health.json")["normals_averted"] == 0


def test_the_body_occlusion_ratio_is_near_the_true_one(made: Path) -> None:
    true, found = numbers(made / "truth" / "health.json"), numbers(made / "occlusion" / "health.json")
    assert found["bor_area"] == pytest.approx(true["bor_area"], abs=0.08)
    assert 0.3 < true["bor_area"] < 0.55
    surface = read_npz(made / "truth" / "surface.npz")
    assert surface["seen"].shape == (5, len(surface["area"]))
    assert true["turned_away/a000"] < 75


def test_every_stage_leaves_an_avatar_pictures_and_provenance(made: Path) -> None:
    tensors, _ = read_tensors(made / "occlusion" / "avatar.safetensors")
    assert len(tensors["positions"]) > 5000
    metrics = json.loads((made / "evaluate" / "metrics.json").read_text())
    assert set(metrics["cameras"]) == {"a000", "a180"}
    error = numbers(made / "monocular" / "health.json")["mpjpe"]
    assert error < 15  # cm: perfect keypoints, hardly any iterations
    record = read_json(made / "masks" / "a180.provenance.json")
    assert {"given", "frames", "keypoints"} <= set(record["inputs"])
    assert (made / "truth" / "evidence.jpg").stat().st_size > 1000


def test_maps_of_another_clip_are_named(made: Path, tmp_path: Path) -> None:
    path = shutil.copy(made / "maps" / "a000.zip", tmp_path)
    with pytest.raises(ArtifactError, match="does not belong to this sequence"):
        archive(Path(path), 6, "alpha")
    with pytest.raises(ArtifactError, match="does not belong to this sequence"):
        archive(Path(path), 5, "depht")
