"""The stage ``body`` from files of another tool and from a network: files in, a body in the world and figures out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from soar.artifacts import write_images, write_json
from soar.body import measure
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT
from soar.body.parameters import HandSpace, axis_angles, matrices
from soar.datasets.sequence import Sequence, Subject
from soar.errors import ConfigError, InputError
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.perception.keypoints import Keypoints
from soar.stages import Job, body, monocular
from tests.body import stickman
from tests.conftest import conf
from tests.importers import person, writers
from tests.importers.test_pose_network import write_network

MODEL = person.body(torch.float32)
HANDS = HandSpace.of(MODEL)
FRAMES, SIZE = 4, (240, 320)
QUICK = {"iterations": 25, "silhouette": {"rounds": 1, "iterations": 8, "scale": 1.0, "stride": 6}}


def cameras() -> tuple[Camera, ...]:
    """The training camera, and one at its side that looks at the same place."""
    front = person.camera(450.0, SIZE, person.elsewhere())
    middle = front.R.T @ (np.array([0.0, 0, 4]) - front.t)
    local = np.eye(4)
    local[:3, :3] = person.rotation(np.array([0, 0.9, 0]))
    local[:3, 3] = np.array([0, 0, 4]) - local[:3, :3] @ np.array([0, 0, 4])
    side = dataclasses.replace(front, name="cam1", T_cam_from_world=local @ front.T_cam_from_world)
    np.testing.assert_allclose(side.to_camera(middle), [0, 0, 4], atol=1e-9)
    return front, side


def _what() -> person.Truth:
    """The person in the picture's middle, whose fingers do not move."""
    what = person.truth(FRAMES)
    held = np.repeat(what.hands[:1], FRAMES, 0)
    return dataclasses.replace(what, transl=what.transl + np.array([0.0, -0.3, 0.0]), hands=held)


WHAT = _what()


def motion() -> BodyMotion:
    """The person in the world."""
    front = cameras()[0]
    pose = WHAT.pose()
    pose[:, 0] = axis_angles(front.R.T @ matrices(WHAT.orient))
    pelvis = person.joints_of(MODEL, WHAT)[:, 0]
    rest = (MODEL.J_template + MODEL.J_shapedirs @ torch.from_numpy(WHAT.betas).float())[0].numpy()
    placed = (pelvis - front.t) @ front.R - rest
    tensors = (torch.from_numpy(x).float() for x in (WHAT.betas, pose, placed))
    return BodyMotion(*tensors, torch.zeros(COUNT, 3))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Inputs of the stage for the two cameras; the second evaluates."""
    root, moved = tmp_path_factory.mktemp("recording"), motion()
    MODEL.save(root / "smplx.npz")
    points = measure.motion_keypoints(MODEL, moved)
    for camera in cameras():
        pixels = np.nan_to_num(camera.project(points))
        confidence = np.broadcast_to(MODEL.keypoint_valid.numpy()[:, None], (FRAMES, COUNT, 1))
        record = Keypoints(
            np.concatenate([pixels, confidence], -1), np.zeros((FRAMES, 33, 3)), np.ones((FRAMES, 4)), np.ones(FRAMES),
            np.zeros((FRAMES, 25)),
        )  # fmt: skip
        record.write(root / f"keypoints/{camera.name}.npz")
        inside = [measure.body_mask(camera, measure.frame_vertices(MODEL, moved, t), MODEL) for t in range(FRAMES)]
        write_images(root / f"masks/{camera.name}.zip", (255 * m.astype(np.uint8) for m in inside), ".png")
        grey = (np.full((*SIZE[::-1], 3), 90, np.uint8) for _ in inside)
        write_images(root / f"frames/{camera.name}.zip", grey, ".jpg")
    return {"body_model": root / "smplx.npz"} | {name: root / name for name in ("keypoints", "masks", "frames")}


def run(
    recording: dict[str, Path], folder: Path, node: dict[str, Any], eval_: bool = False, train: int = 1, **more: Path
) -> tuple[BodyMotion, Health]:
    """One job on the first camera, with the second one as evaluation or training camera."""
    views = cameras()[: max(1 + eval_, train)]
    names = tuple(camera.name for camera in views)
    folder.mkdir(parents=True, exist_ok=True)
    Sequence(
        name="walk", fps=30.0, frame_ids=tuple(range(FRAMES)), up=np.array([0, 0, 1.0]), train=names[:train],
        eval=names[train:], cameras=views, sources=(),
        subject=Subject(point=None, box=None, frame=0, stature_m=None, camera="cam0"), remarks=(),
    ).write(folder / "sequence.json")  # fmt: skip
    write_json(folder / "calibration.json", {"cameras": [camera.to_json() for camera in views]})
    inputs = recording | more | {k: folder / f"{k}.json" for k in ("sequence", "calibration")}
    outputs = {
        "body": folder / "body.npz", "cameras": folder / "cameras.json", "health": folder / "health.json",
        "evidence": folder / "evidence.jpg",
    }  # fmt: skip
    cfg = {"body": node, "monocular": conf("monocular", "default")}
    body.run(inputs, outputs, cfg, Job("walk", None, 0, 1, folder))
    assert outputs["evidence"].stat().st_size > 3000
    return BodyMotion.read(outputs["body"]), Health.read(outputs["health"])


def node(option: str, **changes: Any) -> dict[str, Any]:
    """``conf/body/<option>.yaml`` over ``cpu``, as Hydra composes it, made quick."""

    def over(a: dict[str, Any], b: dict[str, Any]) -> dict[str, Any]:
        return a | {k: over(a[k], v) if isinstance(v, dict) and k in a else v for k, v in b.items()}

    own = conf("body", option)
    own.pop("defaults")
    return over(over(over(conf("body", "cpu"), own), QUICK), changes)


def jolted() -> person.Truth:
    """The person as an estimator might see it: joints off by a tenth of a radian, and fingers and jaw as they are."""
    rng = np.random.default_rng(0)
    return dataclasses.replace(WHAT, body=WHAT.body + rng.normal(0, 0.1, WHAT.body.shape))


def virtual(folder: Path, what: person.Truth) -> Path:
    """SMPLer-X's files of a person in front of a camera ten times as far and as long; frame 3 was not detected."""
    far = person.camera(4500.0, SIZE)
    pelvis = person.joints_of(MODEL, what)[:, 0]
    away = dataclasses.replace(what, transl=what.transl + pelvis * (0, 0, 9.0))
    writers.smplerx(folder, away, far, HANDS)
    (folder / "smplx/00003_0.npz").unlink()
    return folder


def test_imported_parameters_as_they_are(recording: dict[str, Path], tmp_path: Path) -> None:
    source = virtual(tmp_path / "smplerx", WHAT)
    found, health = run(recording, tmp_path / "a", node("imported", refine=False), eval_=True, source=source)
    truth = motion()
    np.testing.assert_allclose(found.betas, truth.betas)
    rows = [0, 1, 3]
    np.testing.assert_allclose(found.pose[rows, 1:], truth.pose[rows, 1:], atol=1e-4)
    np.testing.assert_allclose(found.pose[2, 1:], (truth.pose[1, 1:] + truth.pose[3, 1:]) / 2, atol=0.02)
    apart = [
        np.linalg.norm(matrices(a).T @ matrices(b) - np.eye(3))
        for a, b in zip(found.pose[:, 0], truth.pose[:, 0], strict=True)
    ]
    assert max(apart) < 0.1
    assert np.linalg.norm(found.translation - truth.translation, axis=1).max() < 0.05
    assert health.numbers["interpolated"]["value"] == 0.25
    numbers = {name: entry["value"] for name, entry in health.numbers.items()}
    assert numbers["start_reprojection_limbs"] == pytest.approx(numbers["reprojection_limbs/cam0"])
    assert numbers["overlap/cam0"] > 0.8
    assert numbers["turned/cam0"] == 0
    assert "3 of the clip's 4 are used" in health.remarks[0]
    assert "frame 2" in health.remarks[1]


def test_imported_parameters_refined(recording: dict[str, Path], tmp_path: Path) -> None:
    """The start's pose comes nearer to the keypoints; fingers that no keypoint shows, jaw and eyes stay the start's."""
    source = virtual(tmp_path / "smplerx", jolted())
    found, health = run(recording, tmp_path / "a", node("imported"), source=source)
    numbers = {name: entry["value"] for name, entry in health.numbers.items()}
    assert numbers["reprojection_limbs"] < 0.6 * numbers["start_reprojection_limbs"]
    assert {"term_data", "term_preserve", "term_silhouette"} <= set(numbers)
    assert "term_world" not in numbers
    truth = motion()
    rows = [0, 1, 3]
    np.testing.assert_allclose(found.pose[rows, 22:25], truth.pose[rows, 22:25], atol=1e-5)
    assert float((found.pose[rows, 25:] - truth.pose[rows, 25:]).abs().mean()) < 0.02
    error = np.linalg.norm(measure.motion_keypoints(MODEL, found) - measure.motion_keypoints(MODEL, truth), axis=-1)
    assert np.nanmedian(error) < 0.06


def test_parameters_of_the_world_for_several_training_cameras(recording: dict[str, Path], tmp_path: Path) -> None:
    """EasyMocap's are in the axes of the calibration; those of a camera would not say of which one."""
    world = motion()
    what = dataclasses.replace(
        WHAT, orient=world.pose[:, 0].double().numpy(), transl=world.translation.double().numpy()
    )
    rest = (MODEL.J_template + MODEL.J_shapedirs @ world.betas)[0].double().numpy()
    source = writers.easymocap(tmp_path / "easymocap", what, cameras()[0], HANDS, pelvis=rest)
    options = node("imported", format="easymocap", refine=False)
    found, _ = run(recording, tmp_path / "a", options, train=2, source=source)
    np.testing.assert_allclose(found.pose, world.pose, atol=1e-4)
    np.testing.assert_allclose(found.translation, world.translation, atol=1e-4)
    far = virtual(tmp_path / "smplerx", WHAT)
    with pytest.raises(ConfigError, match="in the axes of a camera, and there are several"):
        run(recording, tmp_path / "b", node("imported"), train=2, source=far)


def test_the_network(recording: dict[str, Path], tmp_path: Path) -> None:
    """A network that always sees the person upright before it; the fit bends the body from there."""
    bias = {"root_pose": WHAT.orient[1], "cam_trans": np.array([0, -0.35, 55.0]), "body_pose": WHAT.body[1].ravel()}
    network = write_network(tmp_path / "n.onnx", bias, gain=1e-3)
    options = node("regressor", hands=False)
    _, raw = run(recording, tmp_path / "a", options | {"refine": False}, network=network)
    found, refined = run(recording, tmp_path / "b", options, network=network)
    before, after = (health.numbers["reprojection_limbs"]["value"] for health in (raw, refined))
    assert before < 40
    assert after < 0.5 * before
    assert len(found) == FRAMES
    assert refined.numbers["interpolated"]["value"] == 0


def test_what_does_not_fit_is_named(recording: dict[str, Path], tmp_path: Path) -> None:
    source = virtual(tmp_path / "smplerx", WHAT)
    stickman.body(torch.float32).save(tmp_path / "other.npz")
    with pytest.raises(ConfigError, match="those of SMPL-X") as caught:
        run(recording | {"body_model": tmp_path / "other.npz"}, tmp_path / "a", node("imported"), source=source)
    assert "body_model=smplx" in str(caught.value)
    with pytest.raises(ConfigError, match=r"body\.source is not set"):
        run(recording, tmp_path / "a", node("imported"))
    with pytest.raises(ConfigError, match=r"body\.network is not set"):
        run(recording, tmp_path / "a", node("regressor"))
    with pytest.raises(ConfigError, match=r"unknown body\.format") as caught:
        run(recording, tmp_path / "a", node("imported", format="amass"), source=source)
    assert "smplerx" in str(caught.value)
    with pytest.raises(ConfigError, match="unknown sauce"):
        run(recording, tmp_path / "a", node("imported", sauce="x"), source=source)
    with pytest.raises(ConfigError, match="must be positive"):
        run(recording, tmp_path / "a", node("imported", focal=-1.0), source=source)
    with pytest.raises(InputError, match="nobody in the body parameters is where"):
        run(recording, tmp_path / "a", node("imported", image_size=[60, 80]), source=source)


def test_the_fit_s_own_settings_are_those_of_other_providers() -> None:
    """What the one-camera check fits with, whatever the provider of the start is."""
    for option in ("imported", "regressor"):
        fit = body.monocular({"body": node(option), "monocular": conf("monocular", "default")})
        assert set(fit) == set(conf("body", "cpu"))
        assert fit["provider"] == "fit"
    assert monocular.body is body
