"""People made by program as a dataset: who they are, where they face, and what is known of them."""

from __future__ import annotations

import copy
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from soar.body import measure
from soar.body.lbs import rest_vertices
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT, LIMBS
from soar.body.record import BodyModel
from soar.datasets import adapter, known
from soar.datasets.capture import Capture
from soar.datasets.ingest import describe, stored_frames
from soar.datasets.planes import DEPTH_STEP, cropped_normals, normals_of, picture_of
from soar.errors import ConfigError
from soar.geometry.cameras import Camera
from soar.geometry.meshes import vertex_normals
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from soar.perception.body_normals import body_maps
from soar.perception.given import projected
from soar.raster import Pinhole
from soar.stages.truth import surface
from soar.synthetic import clips
from soar.workflow import composed
from tests.conftest import ROOT, model_file

FRAMES = 8
SMALL = (
    "dataset=synthetic",
    f"dataset.frames.count={FRAMES}",
    "dataset.frames.fps=2",
    "dataset.cameras.size=[144,160]",
    f"dataset.models={ROOT / 'data' / 'models'}",
    "dataset.people.render.subdivisions=0",
)
TURN, DANCE = "benchmark-0001-turn", "benchmark-0003-dance"


def node(*overrides: str) -> dict:
    return copy.deepcopy(composed((*SMALL, *overrides))["dataset"])


@pytest.fixture(scope="module")
def body() -> BodyModel:
    model_file("body/anny_helpers.npz")
    return BodyModel.load(model_file("body/anny.npz"))


@pytest.fixture(scope="module")
def captures(body: BodyModel) -> dict[str, Capture]:
    made = adapter(node())
    return {name: made.capture(name) for name in (TURN, DANCE)}


@pytest.fixture(scope="module")
def capture(captures: dict[str, Capture]) -> Capture:
    return captures[TURN]


def silhouette(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture).max(-1) > 0


# --- who and what ----------------------------------------------------------------------------------------------------


def test_names_and_split() -> None:
    made = adapter(node("dataset.first=2", "dataset.count=3", "dataset.family=train"))
    assert made.sequences() == ["train-0002-reach", "train-0003-dance", "train-0004-walk"]
    name = made.sequences()[0]
    assert made.cameras(name) == ["a000", "a045", "a135", "a180", "a270"]
    assert made.cameras(name, "train") == ["a000"]
    assert made.cameras(name, "eval") == ["a045", "a135", "a180", "a270"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("family", "elves"), ("first", -1), ("count", 0), ("motions", []), ("turn", 80), ("frames.count", 1),
        ("frames.fps", 0), ("frames.jpeg_quality", 0), ("cameras.eval", [45, 405]), ("cameras.eval", [0]),
        ("cameras.distance", 1), ("cameras.elevation", 80), ("cameras.size", [32, 512]), ("cameras.fill", 1.2),
    ],
)  # fmt: skip
def test_values_out_of_range_are_named(key: str, value: object) -> None:
    changed = node()
    *path, last = key.split(".")
    (changed[path[0]] if path else changed)[last] = value
    with pytest.raises(ConfigError, match=f"dataset.{key}"):
        adapter(changed)


def test_an_unknown_motion_is_named(body: BodyModel) -> None:
    made = adapter(node("dataset.motions=[fly]"))
    with pytest.raises(ConfigError, match="kind of motion"):
        made.capture(made.sequences()[0])


def test_parsing_loads_no_numerical_library() -> None:
    code = (
        "import sys; from soar.workflow import Workflow; Workflow({'dataset': 'synthetic'}).everything(); "
        "assert not {'torch', 'cv2', 'onnxruntime', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_same_seed_gives_the_same_bytes(capture: Capture, tmp_path: Path) -> None:
    """Whatever the order of keys in a configuration: jobs get theirs as sorted JSON."""
    again = adapter(json.loads(json.dumps(node(), sort_keys=True))).capture(TURN)
    for name, made in (("a", capture), ("b", again)):
        describe(made).write(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    for camera in list(capture.recordings)[:2]:
        first, second = (list(made.recordings[camera].frames([0, 5])) for made in (capture, again))
        np.testing.assert_array_equal(first, second)
    for name, plane in capture.truth.planes(capture.cameras[0], 3).items():
        np.testing.assert_array_equal(plane, again.truth.planes(again.cameras[0], 3)[name])


def test_frames_may_be_read_in_any_selection(capture: Capture) -> None:
    sequence, name = describe(capture), capture.cameras[1].name
    stored = list(stored_frames(capture, sequence, name))
    assert (len(stored), stored[0].shape) == (FRAMES, (160, 144, 3))
    np.testing.assert_array_equal(stored[6], next(capture.recordings[name].frames([6])))
    assert np.abs(stored[0].astype(int) - stored[6]).mean() > 1


def test_other_seeds_and_cameras_give_other_digests(captures: dict[str, Capture]) -> None:
    digests = [entry.digest() for c in captures.values() for entry in c.recordings.values()]
    assert len(set(digests)) == len(digests)


# --- where they face -------------------------------------------------------------------------------------------------


def test_turned_away_measures_the_angle_on_the_ground(body: BodyModel) -> None:
    J = len(body.joint_names)
    turns = torch.tensor([0.0, 40.0, -100.0, 180.0])
    about_up = torch.deg2rad(turns)[:, None] * body.up
    pose = torch.zeros(4, J, 3)
    pose[:, 0] = matrix_to_axis_angle(axis_angle_to_matrix(about_up))
    motion = BodyMotion(torch.zeros(body.shapedirs.shape[-1]), pose, torch.zeros(4, 3), torch.zeros(COUNT, 3))
    root = body.J_template[0].double().numpy()
    (camera,) = clips.ring(root + np.eye(3)[[0, 0]] * [[0.1], [-0.1]], {"a": 0.0}, 20, 50.0, (100, 100), 0.5)
    np.testing.assert_allclose(
        measure.turned_away(body, motion, camera), np.repeat([[0], [40], [100], [180]], 2, 1), atol=2
    )


@pytest.mark.parametrize("seed", range(4))
def test_nobody_turns_their_back_to_the_training_camera(
    captures: dict[str, Capture], body: BodyModel, seed: int
) -> None:
    people, turn = captures[TURN].truth._clip.people, 60
    for kind in ("walk", "turn", "reach", "dance"):
        times = np.arange(40) / 5  # twice as long as by default
        subject = people.subject("benchmark", seed)
        moved = clips.facing_forward(people.motion(subject, kind), times, turn).body_motion(times, subject.betas)
        away = measure.turned_away(body, moved, captures[TURN].cameras[0])
        assert away.max() < 75, kind
        if kind == "turn":
            assert away.max() > 50  # they do turn
            headings = moved.pose[:, 0, 2]
            assert headings.max() > 0.6 and headings.min() < -0.6  # noqa: PT018  both ways
        assert np.ptp(moved.translation.numpy()[:, :2], axis=0).max() < 1e-6  # on the spot


def test_a_clip_that_shows_the_back_is_refused(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("soar.datasets.synthetic._TURNED_AWAY", 20.0)
    with pytest.raises(ConfigError, match="turns their back"):
        adapter(node()).capture(TURN)


@pytest.mark.parametrize("name", [TURN, DANCE])
def test_cameras_stand_round_the_person_and_see_all_of_them(
    captures: dict[str, Capture], name: str, body: BodyModel
) -> None:
    capture = captures[name]
    middle = np.concatenate([measure.frame_vertices(body, capture.truth.body(range(FRAMES)), t) for t in range(FRAMES)])
    low, high = middle.min(0), middle.max(0)
    centre = (low + high) / 2
    for camera in capture.cameras:
        away = camera.centre - centre
        azimuth = np.degrees(np.arctan2(away[0], -away[1])) % 360
        assert azimuth == pytest.approx(int(camera.name[1:]), abs=0.01)
        assert np.linalg.norm(away) == pytest.approx(4.0)
        assert np.degrees(np.arcsin(away[2] / 4)) == pytest.approx(5)
        assert camera.R[1] @ [0, 0, 1] < 0  # down in the image is down
        share = np.abs(camera.project(middle) - [72, 80]).max(0) / [72, 80]
        assert share.max() <= 0.851
    assert max(np.abs(c.project(middle) / [72, 80] - 1).max() for c in capture.cameras) == pytest.approx(
        0.85, abs=0.002
    )
    assert len({camera.K[0, 0] for camera in capture.cameras}) == 1


# --- what is known ---------------------------------------------------------------------------------------------------


def views(capture: Capture) -> list[tuple[Camera, int]]:
    return [(camera, (3 * i) % FRAMES) for i, camera in enumerate(capture.cameras)]


@pytest.mark.parametrize("name", [TURN, DANCE])
def test_the_known_body_lies_on_the_person(captures: dict[str, Capture], name: str, body: BodyModel) -> None:
    capture = captures[name]
    motion = capture.truth.body(range(FRAMES))
    for camera, t in views(capture):
        planes = capture.truth.planes(camera, t)
        mask = measure.body_mask(camera, measure.frame_vertices(body, motion, t), body)
        assert measure.overlap(mask, silhouette(planes["body_front"])) > 0.93
        assert (planes["alpha"][mask] > 0.25).mean() > 0.97  # clothes and hair only add to it


def test_the_person_is_where_the_mask_says(capture: Capture) -> None:
    for camera in capture.cameras[:2]:
        first, second = list(capture.recordings[camera.name].frames([0, 4]))
        alpha = np.stack([capture.truth.planes(camera, t)["alpha"] for t in (0, 4)])
        change = np.abs(first.astype(int) - second).max(-1)
        assert not change[(alpha == 0).all(0)].any()  # wall and floor stand still
        assert (change[(alpha[0] == 1) != (alpha[1] == 1)] > 10).mean() > 0.8


def test_keypoints_lie_in_the_body(capture: Capture, body: BodyModel) -> None:
    motion = capture.truth.body(range(FRAMES))
    for camera, t in views(capture):
        record, report = projected(body, motion, camera)
        assert record.present.all() and not report.swapped.any()  # noqa: PT018
        assert record.keypoints[..., 2].sum() == FRAMES * body.keypoint_valid.sum()
        mask = measure.body_mask(camera, measure.frame_vertices(body, motion, t), body)
        column, row = np.floor(record.keypoints[t, list(LIMBS), :2]).astype(int).T
        assert mask[row, column].all()
        # Metric landmarks are the same points: right and down in the picture, away from the camera.
        world, pixels = record.world[t, 11:17], record.keypoints[t, [5, 2, 6, 3, 7, 4], :2]
        hips = camera.to_camera(measure.motion_keypoints(body, motion)[t, 8])
        again = (world + hips) @ camera.K.T
        np.testing.assert_allclose(again[:, :2] / again[:, 2:], pixels, atol=0.01)


def test_keypoints_beyond_the_picture_do_not_count(capture: Capture, body: BodyModel) -> None:
    camera, motion = capture.cameras[0], capture.truth.body(range(2))
    narrow = dataclasses.replace(camera, height=60)  # down to the shoulders or so
    confidence = projected(body, motion, narrow)[0].keypoints[0, :, 2]
    assert confidence[0] == 1  # the nose
    assert not confidence[[10, 11, 13, 14]].any()  # knees and ankles


def test_the_training_camera_sees_the_front_and_not_the_back(captures: dict[str, Capture], body: BodyModel) -> None:
    capture = captures[DANCE]
    camera, motion = capture.cameras[0], capture.truth.body(range(FRAMES))
    seen = np.stack([capture.truth.seen(camera, t) for t in range(FRAMES)])
    exterior, area = surface(body, motion)
    rest = rest_vertices(body, motion.betas)
    faces = body.faces[~body.interior]
    lean = (vertex_normals(rest, faces) @ body.front).numpy()
    trunk = exterior & np.isin(
        body.weights.argmax(1), [i for i, n in enumerate(body.joint_names) if n.startswith("spine")]
    )
    assert (trunk & (lean < -0.7)).sum() > 50
    assert seen[:, trunk & (lean < -0.7)].mean() < 0.01
    assert seen.any(0)[trunk & (lean > 0.7)].mean() > 0.95
    never = ~seen.any(0)
    assert 0.25 < area[never].sum() / area.sum() < 0.5
    assert area.sum() == pytest.approx(1.8, rel=0.25)  # a person's skin, square metres
    behind = np.stack([capture.truth.seen(capture.cameras[3], t) for t in range(FRAMES)]).any(0)
    assert behind[trunk & (lean < -0.7)].mean() > 0.95


def test_normals_face_the_camera_and_are_not_mirrored(capture: Capture, body: BodyModel) -> None:
    motion = capture.truth.body(range(FRAMES))
    for camera, t in views(capture):
        planes = capture.truth.planes(camera, t)
        for side, sign in (("front", -1), ("back", 1)):
            for plane in (side, f"body_{side}"):
                normals = planes[plane][silhouette(planes[plane])]
                np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
                assert (sign * normals[:, 2] >= -1e-6).all()
        local = torch.from_numpy(camera.to_camera(measure.frame_vertices(body, motion, t)).astype(np.float32))
        pinhole = Pinhole.from_K(camera.K, camera.width, camera.height)
        for maps, side in zip(
            body_maps(local, body.faces[~body.interior], pinhole, "auto"), ("front", "back"), strict=True
        ):
            both = silhouette(maps) & silhouette(planes[f"body_{side}"])
            cosine = (maps * planes[f"body_{side}"]).sum(-1)[both]
            assert np.degrees(np.arccos(np.median(cosine).clip(-1, 1))) < 8


def test_depth_is_the_distance_of_the_person(capture: Capture) -> None:
    for camera, t in views(capture):
        planes = capture.truth.planes(camera, t)
        depth = planes["depth"][planes["alpha"] > 0]
        assert 3.2 < depth.min() < depth.max() < 4.8
        assert (planes["depth"][planes["alpha"] == 0] == 0).all()


def test_pictures_hold_what_they_stand_for(capture: Capture) -> None:
    planes = capture.truth.planes(capture.cameras[0], 0)
    front = normals_of(picture_of("front", planes["front"]))
    assert (silhouette(front) == silhouette(planes["front"])).all()
    assert np.abs(front - planes["front"]).max() < 0.005
    assert np.abs(picture_of("depth", planes["depth"]) * DEPTH_STEP - planes["depth"]).max() <= DEPTH_STEP
    assert np.abs(picture_of("alpha", planes["alpha"]) / 255 - planes["alpha"]).max() < 0.002


def test_cropped_normals_are_those_of_the_window(capture: Capture) -> None:
    picture = picture_of("front", capture.truth.planes(capture.cameras[0], 0)["front"])
    whole = normals_of(picture)
    same = cropped_normals(picture, 1.0, np.array([-10, 20, 120, 100]))
    np.testing.assert_allclose(same[:, 10:], whole[20:120, :110], atol=0.01)
    assert not same[:, :10].any()
    half = cropped_normals(picture, 0.5, np.array([0, 0, 72, 80]))
    inside = silhouette(half)
    np.testing.assert_allclose(np.linalg.norm(half[inside], axis=1), 1, atol=1e-5)
    cosine = (half * whole[::2, ::2]).sum(-1)[inside & silhouette(whole[::2, ::2])]
    assert np.median(cosine) > 0.98


def test_a_dataset_that_knows_nothing_says_so(monkeypatch: pytest.MonkeyPatch, capture: Capture) -> None:
    monkeypatch.setattr(
        "soar.datasets.synthetic.Synthetic.capture", lambda self, name: dataclasses.replace(capture, truth=None)
    )
    with pytest.raises(ConfigError, match="knows nothing"):
        known(node(), TURN)
