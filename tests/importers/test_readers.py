"""Every format, written as its tool does, read, and seen by a camera again: joints fall where they came from."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from soar.body.openpose import COUNT
from soar.body.parameters import SMPL_PELVIS, HandSpace, in_world, motion_of
from soar.errors import ConfigError, InputError
from soar.geometry.cameras import Camera
from soar.importers.archive import Archive, Known
from soar.importers.registry import FORMATS, MOTIONS, read_parameters
from tests.importers import person, writers

MODEL = person.body()
SMPL = person.body(pelvis=np.array(SMPL_PELVIS))
HANDS = HandSpace.of(MODEL)
SIZE = (640, 480)


def assumed(kind: str) -> Camera:
    """A camera as the tool assumes it where it does not say, so that its pixels are ours exactly."""
    focal = {"phalp": 5000 / 256 * 640, "wham": 800.0, "smplifyx": 5000.0}.get(kind, 900.0)
    return person.camera(focal, SIZE, person.elsewhere() if kind == "romp" else None)


def depth(kind: str) -> float:
    return assumed(kind).K[0, 0] / 225


def written(folder: Path, kind: str, what: person.Truth, **more: object) -> Archive:
    if kind == "easymocap":
        more["pelvis"] = np.asarray((MODEL.J_template + MODEL.J_shapedirs @ _betas(what))[0])
    path = writers.WRITERS[kind](folder / kind, what, assumed(kind), HANDS, **more)
    return read_parameters(kind, path, Known(SIZE, None, HANDS))


def _betas(what: person.Truth):
    return MODEL.v_template.new_tensor(what.betas)


def world_joints(archive: Archive, camera: Camera) -> np.ndarray:
    """(T, 55, 3) of the first person, posed joint by joint."""
    motion = motion_of(in_world(archive.people[0], MODEL, camera), MODEL)
    betas = motion.betas.double().numpy()
    posed = [person.joints(MODEL, pose, betas) for pose in motion.pose.double().numpy()]
    return np.stack(posed) + motion.translation.double().numpy()[:, None]


@pytest.mark.parametrize("kind", sorted(writers.WRITERS))
def test_joints_fall_on_the_pixels_they_came_from(tmp_path: Path, kind: str) -> None:
    what = person.truth(depth=depth(kind), aside=0.4)
    # Where the betas are another body's, the joints that come back are those of the mean, in SMPL's place.
    smpl = kind in writers.SMPL
    seen = (SMPL, dataclasses.replace(what, betas=0 * what.betas)) if smpl else (MODEL, what)
    local = person.joints_of(*seen)
    camera = assumed(kind) if kind != "easymocap" else person.camera(900.0, SIZE)
    K = camera.K
    expected = (local @ K.T)[..., :2] / (local @ K.T)[..., 2:]
    archive = written(tmp_path, kind, what)
    got = camera.project(world_joints(archive, camera))
    kept = slice(0, 22) if smpl or kind == "gvhmr" else slice(0, 55)
    np.testing.assert_allclose(got[:, kept], expected[:, kept], atol=0.02)
    assert archive.first == (kind == "smplerx")
    assert archive.of_camera == (kind != "easymocap")


@pytest.mark.parametrize("kind", ["smplerx", "smplifyx", "easymocap", "params"])
def test_hands_are_rotations_from_the_flat_hand(tmp_path: Path, kind: str) -> None:
    what = person.truth()
    (found,) = written(tmp_path, kind, what).people
    assert found.left_hand is not None
    np.testing.assert_allclose(found.left_hand.reshape(-1, 45), what.hands[:, 0], atol=1e-6)
    np.testing.assert_allclose(found.right_hand.reshape(-1, 45), what.hands[:, 1], atol=1e-6)
    without = read_parameters(kind, tmp_path / kind, Known(SIZE, None, None)).people[0]
    assert without.left_hand is None
    assert (without.rotations()[:, 25:] == np.eye(3)).all()


@pytest.mark.parametrize("kind", sorted(writers.WRITERS))
def test_only_smplx_gives_its_shape(tmp_path: Path, kind: str) -> None:
    (found,) = written(tmp_path, kind, person.truth()).people
    if kind in writers.SMPL:
        assert found.shape is None
        np.testing.assert_array_equal(found.rest_pelvis, SMPL_PELVIS)
    else:
        np.testing.assert_allclose(found.shape[:4], person.truth().betas)


def test_smplerx_people_and_gaps(tmp_path: Path) -> None:
    what = person.truth(6)
    camera = assumed("smplerx")
    writers.smplerx(tmp_path, what, camera, HANDS)
    writers.smplerx(tmp_path, what, camera, HANDS, person=1)
    for frame in (3, 5):
        (tmp_path / f"smplx/{frame:05}_0.npz").unlink()
    archive = read_parameters("smplerx", tmp_path, Known(SIZE, None, None))
    assert [person.frames.tolist() for person in archive.people] == [[1, 2, 4, 6], [1, 2, 3, 4, 5, 6]]
    assert archive.first == 1
    writers.smplerx(tmp_path / "zero", what, camera, HANDS, first=0)
    assert read_parameters("smplerx", tmp_path / "zero", Known(SIZE, None, None)).first == 0


def test_smplifyx_pca_hands_and_codes(tmp_path: Path) -> None:
    import pickle

    writers.smplifyx(tmp_path, person.truth(2), assumed("smplifyx"), HANDS)
    for file in tmp_path.glob("results/*/000.pkl"):
        row = pickle.loads(file.read_bytes())
        row["left_hand_pose"] = row["right_hand_pose"] = np.linspace(0, 1, 12)[None]
        file.write_bytes(pickle.dumps(row))
    (found,) = read_parameters("smplifyx", tmp_path, Known(SIZE, 1234.0, HANDS)).people
    expected = np.linspace(0, 1, 12) @ HANDS.components[1, :12] + HANDS.mean[1]
    np.testing.assert_allclose(found.right_hand[0].ravel(), expected)
    assert found.K[0, 0, 0] == 1234
    row["body_pose"] = np.zeros((1, 32))
    file.write_bytes(pickle.dumps(row))
    with pytest.raises(InputError, match="a code of VPoser"):
        read_parameters("smplifyx", tmp_path, Known(SIZE, None, HANDS))


@pytest.mark.parametrize(
    ("numbers", "hands", "smplx"),
    [(63, False, False), (69, False, False), (72, False, False), (78, True, False), (87, True, True)],
)
def test_easymocap_poses_of_every_length(tmp_path: Path, numbers: int, hands: bool, smplx: bool) -> None:
    rooted = numbers in (63, 69)
    poses = np.arange(1, numbers + 1) / 100
    if not rooted:
        poses[:3] = 0
    one = {"id": 4, "Rh": [[0, 0, 0]], "Th": [[0, 0, 3]], "poses": [poses.tolist()], "shapes": [[0.1] * 10]}
    (tmp_path / "000007.json").write_text(json.dumps({"annots": [one]}))
    (found,) = read_parameters("easymocap", tmp_path, Known(SIZE, None, HANDS)).people
    start = 0 if rooted else 3
    np.testing.assert_allclose(found.body_pose[0].ravel(), poses[start : start + 63])
    assert found.frames.tolist() == [7]
    assert (found.left_hand is not None, found.betas is not None, found.face is not None) == (hands, smplx, smplx)
    if hands:
        np.testing.assert_allclose(found.left_hand[0].ravel(), poses[66:72] @ HANDS.components[0, :6])
        np.testing.assert_allclose(found.right_hand[0].ravel(), poses[72:78] @ HANDS.components[1, :6])
    if smplx:
        np.testing.assert_allclose(found.face[0].ravel(), poses[78:])


def test_romp_without_cameras_and_with_thetas(tmp_path: Path) -> None:
    what = person.truth()
    writers.romp(tmp_path / "a", what, person.camera(900.0, SIZE), HANDS)
    (tmp_path / "a/cameras.npz").unlink()
    arrays = dict(np.load(tmp_path / "a/poses.npz"))
    thetas = np.concatenate([arrays.pop("global_orient"), arrays.pop("body_pose")], 1)
    np.savez(tmp_path / "a/poses_optimized.npz", thetas=thetas, **arrays)
    (found,) = read_parameters("romp", tmp_path / "a", Known(SIZE, None, None)).people
    np.testing.assert_allclose(found.body_pose, what.body)
    assert found.K[0, 0, 0] == pytest.approx(320 / np.tan(np.radians(30)))
    (other,) = read_parameters("romp", tmp_path / "a/poses.npz", Known(SIZE, 700.0, None)).people
    assert other.K[0, 0, 0] == 700


def test_amass_is_a_motion_in_a_world(tmp_path: Path) -> None:
    what = person.truth()
    (found,) = read_parameters("amass", writers.amass(tmp_path / "a.npz", what), Known(SIZE, None, None)).people
    assert found.frame == "world"
    np.testing.assert_allclose(found.rotations()[:, :22], person_matrices(what)[:, :22], atol=1e-9)
    np.testing.assert_allclose(found.left_hand.reshape(-1, 45), what.hands[:, 0])
    motion = motion_of(found, MODEL)
    rest = MODEL.J_template[0].numpy()
    np.testing.assert_allclose(motion.translation.numpy() + rest, what.transl + SMPL_PELVIS, atol=1e-6)
    assert motion.keypoint_offsets.shape == (COUNT, 3)
    assert "amass" in MOTIONS
    assert "amass" not in FORMATS


def person_matrices(what: person.Truth) -> np.ndarray:
    return np.stack([[person.rotation(v) for v in pose] for pose in what.pose()])


def test_an_unknown_format_is_named() -> None:
    with pytest.raises(ConfigError, match="unknown format") as caught:
        read_parameters("spin", Path(), Known(SIZE, None, None))
    assert "smplerx" in str(caught.value)
