"""The record of an SMPL-X file, of a made-up person: what it says, and that everything that takes a body takes it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from soar.avatar.articulate import Articulation, pose
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import canonical_vertices, from_body
from soar.body import correspondence, lbs, measure, pictures, visible
from soar.body.initial import InitialSettings, pose_from_points
from soar.body.motion import BodyMotion
from soar.body.openpose import COUNT, FACE, INDEX, NAMES
from soar.body.parts import BONES, bones_of_vertices, without_side
from soar.body.record import BodyModel
from soar.body.skeleton import collapse
from soar.body.smplx import OPENPOSE, SmplX
from soar.body.smplx_file import JOINTS, VERTICES, SmplxFile, read_smplx
from soar.body.smplx_record import SmplxSettings, build_record
from soar.caption.records import Sighting
from soar.caption.regions import NOWHERE, REGIONS, RegionFinder
from soar.config import settings
from soar.errors import ConfigError
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.prior_inputs import BODY, CANONICAL_CENTRE, PLACE
from soar.perception.body_normals import body_maps
from soar.priors.geometry import BodyGeometry
from soar.raster import Pinhole
from soar.stages import Job, body_model
from tests.body import humanoid, official, stickman
from tests.conftest import conf, model_file


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return official.write(tmp_path_factory.mktemp("smplx") / "SMPLX_NEUTRAL.npz", humanoid.arrays())


@pytest.fixture(scope="module")
def convert(source: Path) -> Callable[..., BodyModel]:
    """What the stage makes of the file, read back; its default body is the small one of the tests."""

    def run(**changes: object) -> BodyModel:
        default, out = source.with_name("default.npz"), source.with_name("record.npz")
        stickman.body(torch.float32).save(default)
        node = conf("body_model", "smplx") | {"interior": "none"} | changes
        inputs, job = {"source": source, "default": default}, Job("", None, 0, 1, source.parent)
        body_model.run(inputs, {"body_model": out}, {"body_model": node}, job)
        return BodyModel.load(out)

    return run


@pytest.fixture(scope="module")
def record(convert: Callable[..., BodyModel]) -> BodyModel:
    return convert()


@pytest.fixture(scope="module")
def file(source: Path) -> SmplxFile:
    return read_smplx(source)


@pytest.fixture(scope="module")
def motion() -> BodyMotion:
    """Three frames of everybody's joints turned a little, the whole body a lot; betas are one and a half."""
    generator = torch.Generator().manual_seed(1)
    turns = 0.25 * torch.randn(3, len(JOINTS), 3, generator=generator)
    turns[:, [JOINTS.index(name) for name in ("jaw", "left_eye_smplhf", "right_eye_smplhf")]] = 0
    turns[:, 0] = torch.tensor([[0.2, 0.0, 0.1], [0.0, 1.0, 0.0], [-0.1, -0.6, 0.2]])
    translation = torch.tensor([0.1, 0.4, -0.2]).expand(3, 3).clone()
    return BodyMotion(torch.linspace(-1.5, 1.5, 10), turns, translation, torch.zeros(COUNT, 3))


def rested(record: BodyModel) -> dict[str, np.ndarray]:
    """Keypoints of the mean body at rest, by name."""
    still = torch.eye(3).expand(len(JOINTS), 3, 3)
    points = lbs.keypoints(record, torch.zeros(10), still, torch.zeros(3)).numpy()
    return {name: points[i] for name, i in INDEX.items()}


# --- what it says ----------------------------------------------------------------------------------------------------


def test_skeleton_and_axes(record: BodyModel) -> None:
    np.testing.assert_allclose(record.J_template, humanoid.joints(), atol=1e-6)
    assert record.joint_names == JOINTS
    height = record.v_template @ record.up
    assert JOINTS[int(record.weights[height.argmax()].argmax())] == "head"
    eyes = record.J_template[[JOINTS.index("left_eye_smplhf"), JOINTS.index("head")]]
    assert (eyes[0] - eyes[1]) @ record.front > 0.05
    assert eyes[0] @ record.left > 0.02
    held = {JOINTS[j] for j in range(len(JOINTS)) if j not in record.active.tolist()}
    assert held == {"jaw", "left_eye_smplhf", "right_eye_smplhf"}
    assert record.stiffness[0] == 0
    assert (record.stiffness[record.active[1:]] > 0).all()
    assert record.hand_mean is not None
    assert record.hand_mean.shape == (2, 45)


def test_keypoints_are_where_their_names_say(record: BodyModel) -> None:
    at = rested(record)
    assert {name for name, valid in zip(NAMES, record.keypoint_valid, strict=True) if not valid} == {
        "left_pupil", "right_pupil",
    }  # fmt: skip
    for name in NAMES[: FACE.start]:
        side = name.partition("_")[0]
        if side in ("left", "right"):
            assert (at[name][0] > 0) == (side == "left"), name
    for part in ("jaw_", "right_brow_", "outer_lip_"):
        first = [at[name][0] for name in NAMES if name.startswith(part)][:5]
        assert (np.diff(first) > -1e-3).all(), part  # from the subject's right
    rows = ["jaw_8", "outer_lip_9", "outer_lip_3", "nostril_2", "nose_bridge_0", "right_brow_2"]
    heights = [at[name][1] for name in rows]
    assert heights == sorted(heights)
    np.testing.assert_allclose(at["neck"], (at["left_shoulder"] + at["right_shoulder"]) / 2, atol=1e-6)
    J = dict(zip(JOINTS, humanoid.joints(), strict=True))
    np.testing.assert_allclose(at["mid_hip"], (J["left_hip"] + J["right_hip"]) / 2, atol=1e-6)
    apart = np.linalg.norm(at["left_hip"] - at["right_hip"]) / np.linalg.norm(J["left_hip"] - J["right_hip"])
    assert apart == pytest.approx(1.5, abs=1e-4)
    for finger, own in (("index", "index"), ("little", "pinky"), ("thumb", "thumb")):
        np.testing.assert_allclose(at[f"right_{finger}_2"], J[f"right_{own}2"], atol=1e-6)
        assert np.linalg.norm(at[f"right_{finger}_4"] - at[f"right_{finger}_3"]) > 0.01
    assert at["left_big_toe"][2] > at["left_heel"][2] + 0.1


def test_posed_vertices_and_keypoints_are_the_model_s(record: BodyModel, file: SmplxFile, motion: BodyMotion) -> None:
    model = SmplX.of(file, 10, 0)
    vertices, joints = model(motion.betas, torch.zeros(0), motion.pose, motion.translation)
    found = lbs.pose_vertices(record, motion.betas, motion.rotations, motion.translation)
    torch.testing.assert_close(found, vertices, atol=1e-5, rtol=0)
    points = lbs.keypoints(record, motion.betas, motion.rotations, motion.translation)
    others = [i for i in range(len(OPENPOSE)) if NAMES[i] not in ("neck", "mid_hip", "left_hip", "right_hip")]
    ahead = [i for i in others if not NAMES[i].startswith("jaw_")]  # the contour that follows the head is left out
    table = torch.tensor(OPENPOSE)
    torch.testing.assert_close(points[:, ahead], joints[:, table[ahead]], atol=1e-5, rtol=0)
    still, zero = torch.zeros(1, len(JOINTS), 3), torch.zeros(1, 3)
    _, joints = model(motion.betas, torch.zeros(0), still, zero)
    points = lbs.keypoints(record, motion.betas, axis_angle_to_matrix(still), zero)
    torch.testing.assert_close(points[:, others], joints[:, table[others]], atol=1e-5, rtol=0)


def test_canonical_pose_levels_arms_and_spreads_legs(record: BodyModel) -> None:
    A = lbs.joint_transforms(record, torch.zeros(10), axis_angle_to_matrix(record.canonical_pose))
    posed = (A[..., :3] @ record.J_template[..., None]).squeeze(-1) + A[..., 3]
    at = dict(zip(JOINTS, posed, strict=True))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg = torch.tensor([0.5 * sign, -(3**0.5) / 2, 0])
        for start, end, direction in (
            ("shoulder", "elbow", sign * record.left), ("elbow", "wrist", sign * record.left),
            ("hip", "knee", leg), ("knee", "ankle", leg),
        ):  # fmt: skip
            along = torch.nn.functional.normalize(at[f"{side}_{end}"] - at[f"{side}_{start}"], dim=0)
            torch.testing.assert_close(along, direction, atol=1e-4, rtol=0)


def test_round_trip_with_everything_optional(record: BodyModel, tmp_path: Path) -> None:
    record.save(tmp_path / "body.npz")
    again = BodyModel.load(tmp_path / "body.npz")
    for field in dataclasses.fields(BodyModel):
        a, b = getattr(record, field.name), getattr(again, field.name)
        assert a is not None
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


def test_more_components_than_the_file_has_are_refused(file: SmplxFile) -> None:
    default, node = stickman.body(torch.float32), conf("body_model", "smplx") | {"interior": "none"}
    for count in (0, 11, 3):
        options = settings(SmplxSettings, node | {"num_betas": count}, "body_model")
        if count == 3:
            assert build_record(file, default, options).shapedirs.shape == (VERTICES, 3, 3)
            continue
        with pytest.raises(ConfigError, match=rf"num_betas(.|\n)*1 to 10(.|\n)*{count}"):
            build_record(file, default, options)


# --- its places on the default body ----------------------------------------------------------------------------------


def test_a_body_s_places_on_itself_are_its_own(record: BodyModel) -> None:
    """Of another shape: the warp undoes it."""
    own = dataclasses.replace(record, place=None)
    axes = torch.stack([record.left, -record.front, record.up])
    torch.testing.assert_close(own.places(), record.v_template @ axes.T)
    outside = torch.unique(record.faces)
    betas = torch.zeros(10)
    betas[0], betas[1] = 1.5, -1.0
    shaped = dataclasses.replace(own, v_template=lbs.rest_vertices(own, betas), J_template=lbs.rest_joints(own, betas))
    apart = (correspondence.places(shaped, own) - own.places()).norm(dim=1)[outside]
    assert apart.quantile(0.95) < 0.02


def test_places_on_the_default_body(file: SmplxFile) -> None:
    """Each large bone lies on its namesake."""
    anny = BodyModel.load(model_file("body/anny.npz"))
    node = settings(SmplxSettings, conf("body_model", "smplx") | {"interior": "none"}, "body_model")
    record = build_record(file, anny, node)
    theirs, ours = np.array(bones_of_vertices(anny)), np.array(bones_of_vertices(record))
    nearest = torch.cdist(record.places()[::20], anny.places()).argmin(1)
    found = theirs[nearest.numpy()]
    for side in (".L", ".R"):
        for bone in ("upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot"):
            mine = ours[::20] == bone + side
            assert (found[mine] == bone + side).mean() > 0.6, bone
            assert not np.char.endswith(found[mine], ".R" if side == ".L" else ".L").any(), bone
    assert (found[ours[::20] == "head"] == "head").mean() > 0.8


# --- faces nobody sees -----------------------------------------------------------------------------------------------


def ball(radius: float, centre: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = humanoid.ball()
    return (radius * vertices + centre).astype(np.float32), faces


def test_hidden_faces() -> None:
    """A ball in another; and one that half sticks out of it."""
    outer, faces = ball(0.1, (0, 0, 0))
    inner, _ = ball(0.04, (0, 0, 0))
    half, _ = ball(0.04, (0.1, 0, 0))
    vertices = np.concatenate([outer, inner, half])
    found = visible.hidden(vertices, np.concatenate([faces, faces + len(outer), faces + 2 * len(outer)]))
    own, within, sticking = np.split(found, 3)
    assert within.all()
    deep = np.linalg.norm(half[faces].mean(1), axis=1)
    np.testing.assert_array_equal(sticking[np.abs(deep - 0.1) > 0.02], (deep < 0.1)[np.abs(deep - 0.1) > 0.02])
    covered = np.linalg.norm(outer[faces].mean(1) - (0.1, 0, 0), axis=1) < 0.015
    np.testing.assert_array_equal(own[covered], True)
    assert own.sum() < 30


def test_the_record_leaves_out_what_is_hidden(
    convert: Callable[..., BodyModel], record: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visible, "_PIXEL", 0.004)
    monkeypatch.setattr(visible, "_VIEWS", 12)
    interior = convert(interior="hidden").interior
    assert not record.interior.any()
    centres = record.v_template[record.faces].mean(1)
    spine = (centres - torch.tensor([0, -0.1, -0.02])).norm(dim=1) < 0.05
    nose = centres[:, 2] > 0.06
    assert spine.any()
    assert interior[spine].all()
    assert interior[nose].float().mean() < 0.6


# --- everything that takes a body takes it ---------------------------------------------------------------------------


def test_surfels_follow_the_skin(record: BodyModel, motion: BodyMotion) -> None:
    """Up to the pose blend shapes, which they keep from the canonical pose, and to blended blends."""
    options = settings(AvatarSettings, conf("avatar", "default"), "avatar")
    avatar = from_body(record, motion.betas, dataclasses.replace(options, subdivisions=0, longest_edge=10.0))
    assert len(avatar) == len(torch.unique(record.faces))
    for body, limit in ((record, 0.03), (dataclasses.replace(record, posedirs=None), 1e-3)):
        articulation = Articulation.of(body, motion)
        canonical = canonical_vertices(body, motion.betas)
        moved, _ = pose(canonical, canonical, articulation.weights, articulation.transforms[1])
        exact = lbs.pose_vertices(body, motion.betas, motion.rotations[1], motion.translation[1])
        assert (moved - exact).norm(dim=1).max() < limit


def test_the_skeleton_of_the_fit(record: BodyModel, motion: BodyMotion) -> None:
    """Keypoints of the fit leave out the pose blend shapes, and nothing else."""
    rotations = motion.rotations
    for body, limit in ((record, 0.03), (dataclasses.replace(record, posedirs=None), 1e-5)):
        skeleton = collapse(body)
        local = rotations[:, skeleton.active]
        points = skeleton.keypoints(
            skeleton.transforms(motion.betas, local), motion.betas, motion.translation, motion.keypoint_offsets
        )
        exact = lbs.keypoints(body, motion.betas, rotations, motion.translation)
        assert (points - exact)[:, body.keypoint_valid].norm(dim=-1).max() < limit


def test_first_poses_find_the_motion(record: BodyModel, motion: BodyMotion) -> None:
    small = dataclasses.replace(motion, betas=torch.zeros(10))
    target = measure.motion_keypoints(record, small)
    options = settings(InitialSettings, conf("body", "cpu")["initial"] | {"iterations": 40}, "body.initial")
    found = pose_from_points(record, collapse(record), target, options)
    full = collapse(record).full_rotations(found.rotations, len(JOINTS))
    points = lbs.keypoints(record, found.betas, full, found.translation).numpy()
    apart = np.linalg.norm(points - target, axis=-1)[:, :25]
    assert np.median(apart) < 0.02


def in_camera(record: BodyModel, motion: BodyMotion, size: int = 1) -> tuple[torch.Tensor, Pinhole]:
    """The body 3 m in front of a camera that sees its front: x right, y down, z away."""
    world = lbs.pose_vertices(record, motion.betas, motion.rotations[0], torch.zeros(3))
    pinhole = Pinhole(150 * size, 150 * size, 64 * size, 80 * size, 128 * size, 160 * size)
    return world * torch.tensor([1.0, -1.0, -1.0]) + torch.tensor([0.0, -0.4, 3.0]), pinhole


def test_body_normals(record: BodyModel, motion: BodyMotion) -> None:
    vertices, pinhole = in_camera(record, motion)
    front, back = body_maps(vertices, record.faces, pinhole, "auto")
    for side, sign in ((front, -1), (back, 1)):
        on = np.abs(side).max(-1) > 0
        assert on.sum() > 700
        assert (sign * side[on][:, 2] > 0).mean() > 0.97


def test_canonical_places_are_drawn(record: BodyModel) -> None:
    """The prior's planes hold the default body's coordinates, not the own ones."""
    still = BodyMotion(torch.zeros(10), torch.zeros(1, len(JOINTS), 3), torch.zeros(1, 3), torch.zeros(COUNT, 3))
    shifted = dataclasses.replace(record, place=record.places() + torch.tensor([0.0, 0.0, 0.25]))
    planes = []
    for body in (record, shifted):
        geometry = BodyGeometry(body)
        torch.testing.assert_close(geometry.place, body.places() - torch.tensor(CANONICAL_CENTRE))
        vertices, pinhole = in_camera(body, still)
        planes.append(geometry.planes(vertices, geometry.normals(vertices), pinhole))
    on = planes[0][BODY][0] == 1
    torch.testing.assert_close((planes[1] - planes[0])[PLACE][2][on], torch.full((int(on.sum()),), 0.25))


def test_parts_and_regions(record: BodyModel) -> None:
    bones = np.array(bones_of_vertices(record))
    assert set(map(without_side, bones)) == set(BONES)
    left = record.v_template @ record.left
    for bone in ("wrist", "foot", "lowerleg01"):
        assert (left[bones == f"{bone}.L"] > 0).all()
    still = BodyMotion(torch.zeros(10), torch.zeros(1, len(JOINTS), 3), torch.zeros(1, 3), torch.zeros(COUNT, 3))
    vertices, pinhole = in_camera(record, still, 3)
    front, _ = body_maps(vertices, record.faces, pinhole, "auto")
    alpha = np.uint8(255 * (np.abs(front).max(-1) > 0))
    sighting = Sighting("front", 0, np.zeros((*alpha.shape, 3), np.uint8), alpha, vertices, pinhole)
    found = RegionFinder(record, 0.0, 0.02, "auto")(sighting)
    seen = {REGIONS[i] for i in np.unique(found[found != NOWHERE])}
    assert {"face", "top of head", "chest", "belly", "hips", "hands", "arm 1", "arm 8", "leg 1", "leg 8"} <= seen
    rows = {name: np.nonzero(found == REGIONS.index(name))[0].mean() for name in ("face", "chest", "hips", "leg 8")}
    assert list(rows.values()) == sorted(rows.values())


def test_pictures_and_figures(record: BodyModel, motion: BodyMotion) -> None:
    (camera,) = stickman.cameras(1)
    turned = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # stand on z, face -y as the cameras expect
    vertices = measure.frame_vertices(record, motion, 0) @ turned.T + (0, 0, 1)
    drawn = pictures.draw_body(np.zeros((camera.height, camera.width, 3), np.uint8), camera, vertices, record)
    assert (drawn.max(-1) > 0).sum() > 3000
    assert measure.stature(record, torch.zeros(10)) == pytest.approx(
        float(np.ptp(record.v_template[:, 1].numpy())), abs=1e-4
    )
