"""The record refuses what is not a body, survives a round trip, and Anny's is what its documentation says."""

import dataclasses

import numpy as np
import pytest
import torch

from soar.artifacts import read_npz, write_npz
from soar.body import lbs
from soar.body.anny import build_record
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT, FACE, GROUPS, INDEX, LIMBS, NAMES, mirror
from soar.body.record import BodyModel
from soar.errors import ArtifactError, ModelFileError
from soar.geometry.rotations import axis_angle_to_matrix
from tests.body import stickman
from tests.conftest import model_file


@pytest.fixture(scope="module")
def anny() -> BodyModel:
    return build_record(read_npz(model_file("body/anny_raw.npz")))


def test_round_trip(tmp_path):
    model = dataclasses.replace(stickman.body(), posedirs=None)
    model.save(tmp_path / "body.npz")
    again = BodyModel.load(tmp_path / "body.npz")
    for field in dataclasses.fields(BodyModel):
        a, b = getattr(model, field.name), getattr(again, field.name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("J_template", lambda x: x[:-1], "wrong shape"),
        ("weights", lambda x: 2 * x, "do not sum to one"),
        ("parents", lambda x: x.flip(0), "not a tree"),
        ("faces", lambda x: x + 10**6, "vertices that do not exist"),
        ("v_template", lambda x: x * float("nan"), "NaN"),
        ("active", lambda x: x[1:], "root"),
    ],
)
def test_malformed_record_names_the_field(field, change, message):
    model = stickman.body()
    with pytest.raises(ModelFileError, match=message):
        dataclasses.replace(model, **{field: change(getattr(model, field))})


def test_load_refuses_missing_truncated_and_foreign_files(tmp_path):
    with pytest.raises(ModelFileError, match="cannot be read"):
        BodyModel.load(tmp_path / "none.npz")
    path = tmp_path / "body.npz"
    stickman.body().save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ModelFileError, match="cannot be read"):
        BodyModel.load(path)
    write_npz(path, {"weights": np.ones((3, 3))})
    with pytest.raises(ModelFileError, match="missing"):
        BodyModel.load(path)


def test_motion_round_trip_and_shapes(tmp_path):
    motion = stickman.motion(stickman.body())
    motion.write(tmp_path / "m.npz")
    again = BodyMotion.read(tmp_path / "m.npz")
    assert torch.equal(motion.pose, again.pose)
    assert len(again) == 6
    with pytest.raises(ArtifactError, match="translation"):
        dataclasses.replace(motion, translation=motion.translation[:-1])
    with pytest.raises(ArtifactError, match="betas"):
        dataclasses.replace(motion, betas=motion.betas * float("nan"))


def test_names_groups_and_mirror():
    assert len(NAMES) == COUNT == len(set(NAMES)) == 137
    assert sorted(i for group in GROUPS.values() for i in group) == list(range(COUNT))
    assert {NAMES[i].split("_")[1] for i in LIMBS} == {"shoulder", "elbow", "wrist", "hip", "knee", "ankle"}
    twin = mirror()
    assert (twin[twin] == np.arange(COUNT)).all()
    for a, b in (
        ("left_wrist", "right_wrist"),
        ("left_little_4", "right_little_4"),
        ("right_pupil", "left_pupil"),
        ("nose", "nose"),
    ):
        assert twin[INDEX[a]] == INDEX[b]
    assert twin[INDEX["jaw_0"]] == INDEX["jaw_16"]
    assert twin[INDEX["right_eye_lid_0"]] == INDEX["left_eye_lid_3"]


def test_raw_arrays_must_be_complete():
    with pytest.raises(ModelFileError, match="incomplete"):
        build_record({"v_template": np.zeros((4, 3))})


def test_anny_keypoints_are_where_their_names_say(anny):
    J = len(anny.J_template)
    eye = torch.eye(3).expand(J, 3, 3)
    points = lbs.keypoints(anny, torch.zeros(anny.shapedirs.shape[-1]), eye, torch.zeros(3)).numpy()
    assert anny.keypoint_valid.all()
    at = {name: points[i] for name, i in INDEX.items()}
    for i, name in enumerate(NAMES[: FACE.start]):
        if name.startswith(("left_", "right_")):
            assert (points[i, 0] > 0) == name.startswith("left_"), name
    # The body is symmetric: every point is its twin's mirror image.
    assert np.abs(points[mirror()] * (-1, 1, 1) - points).max() < 6e-3
    assert at["nose"][1] < at["left_ear"][1]
    assert at["left_big_toe"][1] < at["left_heel"][1]
    assert abs(at["left_small_toe"][0]) > abs(at["left_big_toe"][0])
    order = ["jaw_8", "outer_lip_9", "outer_lip_3", "nostril_2", "nose_bridge_0", "right_brow_2"]
    assert (np.diff([at[n][2] for n in order]) > 0).all()
    assert at["right_eye_lid_0"][0] < at["right_eye_lid_3"][0] < at["left_eye_lid_0"][0] < at["left_eye_lid_3"][0]
    assert at["outer_lip_0"][0] < at["outer_lip_6"][0]
    for side in ("left", "right"):
        assert np.linalg.norm(at[f"{side}_pupil"] - at[f"{side}_eye"]) < 0.02
        for finger in ("thumb", "index", "middle", "ring", "little"):
            steps = np.linalg.norm(np.diff([at[f"{side}_{finger}_{k}"] for k in (1, 2, 3, 4)], axis=0), axis=1)
            assert (steps > 0.012).all()
            assert (steps < 0.07).all()
        assert np.linalg.norm(at[f"{side}_wrist"] - at[f"{side}_hand_wrist"]) < 0.02


def test_anny_canonical_pose_is_vitruvian(anny):
    names = anny.joint_names
    A = lbs.joint_transforms(anny, torch.zeros(anny.shapedirs.shape[-1]), axis_angle_to_matrix(anny.canonical_pose))
    posed = (A[..., :3] @ anny.J_template[..., None]).squeeze(-1) + A[..., 3]

    def direction(a: str, b: str) -> torch.Tensor:
        return torch.nn.functional.normalize(posed[names.index(b)] - posed[names.index(a)], dim=0)

    for side, sign in (("L", 1.0), ("R", -1.0)):
        for a, b in (("upperarm01", "lowerarm01"), ("lowerarm01", "wrist")):
            torch.testing.assert_close(direction(f"{a}.{side}", f"{b}.{side}"), sign * anny.left, atol=1e-4, rtol=0)
        for a, b in (("upperleg01", "lowerleg01"), ("lowerleg01", "foot")):
            expected = torch.tensor([0.5 * sign, 0.0, -(3**0.5) / 2])
            torch.testing.assert_close(direction(f"{a}.{side}", f"{b}.{side}"), expected, atol=1e-4, rtol=0)


def test_anny_golden_vertices(anny):
    """Pins shape space, weights and skinning: a change of any of them moves these points."""
    J, B = len(anny.J_template), anny.shapedirs.shape[-1]
    assert (len(anny.v_template), len(anny.faces), J, B) == (13718, 27420, 104, 10)
    assert abs(lbs.rest_vertices(anny, torch.zeros(B)) @ anny.up).max() < 1.1
    pose = 0.2 * torch.sin(torch.arange(3.0 * J)).reshape(J, 3)
    vertices = lbs.pose_vertices(
        anny, torch.linspace(-1, 1, B), axis_angle_to_matrix(pose), torch.tensor([0.1, 0.2, 0.3])
    )
    golden = torch.tensor(GOLDEN)
    torch.testing.assert_close(vertices[[0, 881, 9316, 2487, 13000]], golden, atol=2e-4, rtol=0)


GOLDEN = [
    [0.0940, 0.0975, 1.0662],
    [0.1260, 0.1866, 1.1702],
    [0.5697, -0.0552, 0.4496],
    [-0.4205, -0.0008, 0.3625],
    [0.2532, 0.1244, -0.5156],
]
