"""Ways of parameters to our camera, world and record."""

import dataclasses

import numpy as np
import pytest
import torch

from soar.body import lbs
from soar.body.parameters import (
    HandSpace,
    SmplxParameters,
    in_world,
    matrices,
    model_betas,
    motion_of,
    poses_of,
    seen_by,
    with_face,
)
from soar.body.skeleton import collapse
from soar.errors import ConfigError, InputError
from soar.geometry.cameras import Camera
from tests.importers import person

MODEL = person.body()
SIZE = (640, 480)


def parameters(what: person.Truth, camera: Camera) -> SmplxParameters:
    T = len(what.frames)
    return SmplxParameters(
        frames=what.frames, global_orient=what.orient, body_pose=what.body, translation=what.transl,
        lever=np.tile(np.eye(3), (T, 1, 1)), frame="camera", betas=np.tile(what.betas, (T, 1)),
        left_hand=what.hands[:, 0].reshape(T, 15, 3), right_hand=what.hands[:, 1].reshape(T, 15, 3), face=what.face,
        K=np.tile(camera.K, (T, 1, 1)), size=(camera.width, camera.height),
    )  # fmt: skip


def posed(found: SmplxParameters) -> np.ndarray:
    """(T, 55, 3) joints in the axes of the parameters."""
    betas = np.zeros(person.BETAS) if found.shape is None else found.shape
    at = found.pelvis(MODEL)
    pose = [np.stack([person.rotation_vector(R) for R in frame]) for frame in found.rotations()]
    joints = np.stack([person.joints(MODEL, p, betas) for p in pose])
    return joints - joints[:, :1] + at[:, None]


def pixels(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    p = points @ K.T
    return p[..., :2] / p[..., 2:]


def test_the_lever_says_where_the_pelvis_is() -> None:
    what, rest = person.truth(), (MODEL.J_template + MODEL.J_shapedirs @ torch.from_numpy(person.truth().betas))[0]
    given = parameters(what, person.camera())
    np.testing.assert_allclose(given.pelvis(MODEL), rest.numpy() + what.transl)
    turned = dataclasses.replace(given, lever=matrices(what.orient))
    np.testing.assert_allclose(turned.pelvis(MODEL)[2], matrices(what.orient[2]) @ rest.numpy() + what.transl[2])
    other = dataclasses.replace(given, betas=None, rest_pelvis=np.array([0.0, 1, 0]))
    np.testing.assert_allclose(other.pelvis(MODEL), what.transl + np.array([0, 1, 0]))


def test_a_change_of_axes_turns_about_the_pelvis() -> None:
    """Joints move as points do, whatever the translation is measured from; betas that move the pelvis included."""
    given, T = parameters(person.truth(), person.camera()), person.elsewhere()
    for lever in (np.eye(3), np.zeros((3, 3)), matrices(given.global_orient)):
        start = dataclasses.replace(given, lever=np.broadcast_to(lever, (len(given), 3, 3)).copy())
        expected = posed(start) @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(posed(start.changed(T[:3, :3], T[:3, 3])), expected, atol=1e-9)


def test_our_own_camera_changes_nothing_and_the_world_is_ours() -> None:
    what, camera = person.truth(aside=0.8), person.camera(T=person.elsewhere())
    given = parameters(what, camera)
    seen = seen_by(given, given.pelvis(MODEL), camera)
    np.testing.assert_allclose(posed(seen), person.joints_of(MODEL, what), atol=1e-9)
    world = in_world(given, MODEL, camera)
    assert (world.frame, world.K) == ("world", None)
    np.testing.assert_allclose(camera.project(posed(world)), pixels(person.joints_of(MODEL, what), camera.K), atol=1e-6)


def virtual(aside: float, yaw: float) -> tuple[SmplxParameters, np.ndarray]:
    """Parameters as a regressor gives them, in a far camera of each crop; and the pixels that they are seen at."""
    what = person.truth(depth=45.0)
    orient = person.rotation_vector(person.rotation(np.array([np.pi, 0, 0])) @ person.rotation(np.array([0, yaw, 0])))
    what = dataclasses.replace(what, orient=np.tile(orient, (5, 1)), transl=np.tile([0, -0.36, 45.0], (5, 1)))
    crops = np.tile(np.array([[9000.0, 0, 0], [0, 9000, 0], [0, 0, 1]]), (5, 1, 1))
    crops[:, 0, 2], crops[:, 1, 2] = 320 + aside + 5 * np.arange(5), 330 - 3 * np.arange(5)
    given = dataclasses.replace(parameters(what, person.camera()), K=crops)
    joints = person.joints_of(MODEL, what)
    return given, np.stack([pixels(joint, K) for joint, K in zip(joints, crops, strict=True)])


@pytest.mark.parametrize("aside", [0.0, 250.0])
def test_the_picture_of_a_crop_s_camera_is_kept(aside: float) -> None:
    """The pelvis exactly, the joints of a person 300 pixels tall to a few percent, at the border of the picture too.

    There the body must turn with the ray: its other sides show otherwise.
    """
    camera, turned, untouched = person.camera(600.0), [], []
    for yaw in (0.0, 1.2, 2.0, 3.0):
        given, expected = virtual(aside, yaw)
        seen = seen_by(given, given.pelvis(MODEL), camera)
        got = pixels(posed(seen), camera.K)
        np.testing.assert_allclose(got[:, 0], expected[:, 0], atol=1e-6)
        np.testing.assert_allclose(seen.translation[:, 2], given.pelvis(MODEL)[:, 2] / 15)
        assert 250 < np.ptp(expected[:, :22, 1], 1).mean() < 350
        kept = pixels(posed(dataclasses.replace(seen, global_orient=given.global_orient)), camera.K)
        for errors, points in ((turned, got), (untouched, kept)):
            errors.append(np.sqrt(((points - expected)[:, :22] ** 2).sum(-1).mean()))
    assert max(turned) < 15  # of 300
    if aside:
        assert np.mean(turned) < 0.7 * np.mean(untouched)


def test_images_of_another_size_scale_the_intrinsics() -> None:
    what, camera = person.truth(), person.camera()
    large = person.camera(1800.0, (1280, 960))
    seen = seen_by(parameters(what, large), parameters(what, large).pelvis(MODEL), camera)
    np.testing.assert_allclose(posed(seen), person.joints_of(MODEL, what), atol=1e-9)
    upright = person.camera(900.0, (480, 640))
    with pytest.raises(InputError, match="another shape"):
        seen_by(parameters(what, upright), parameters(what, upright).pelvis(MODEL), camera)


def test_a_person_behind_the_camera_is_refused() -> None:
    given = parameters(person.truth(depth=-4.0), person.camera())
    with pytest.raises(InputError, match="behind the camera"):
        in_world(given, MODEL, person.camera())


def test_hands() -> None:
    space, rng = HandSpace.of(MODEL), np.random.default_rng(0)
    left, right = rng.standard_normal((2, 3, 6))
    flat = space.flat(left, right, coefficients=True, from_mean=True)
    mean, components = MODEL.hand_mean.numpy(), MODEL.hand_components.numpy()
    np.testing.assert_allclose(flat[1].reshape(3, 45), right @ components[1, :6] + mean[1])
    full = rng.standard_normal((2, 3, 45))
    flat = space.flat(*full, coefficients=False, from_mean=False)
    np.testing.assert_allclose(flat[0].reshape(3, 45), full[0])
    with pytest.raises(ConfigError, match="no mean hand"):
        HandSpace.of(dataclasses.replace(MODEL, hand_mean=None))


def test_motion_and_poses_are_the_same_body() -> None:
    what, camera = person.truth(), person.camera(T=person.elsewhere())
    world = in_world(parameters(what, camera), MODEL, camera)
    motion, poses = motion_of(world, MODEL), poses_of(world, MODEL)
    transforms = lbs.joint_transforms(MODEL, motion.betas.double(), motion.rotations.double())
    rest = lbs.rest_joints(MODEL, motion.betas.double())
    joints = lbs.skin(transforms, torch.eye(55, dtype=torch.float64), rest) + motion.translation.double()[:, None]
    np.testing.assert_allclose(joints, posed(world), atol=1e-5)
    skeleton = collapse(MODEL)
    active = skeleton.transforms(poses.betas, poses.rotations)
    np.testing.assert_allclose(active[:, :22, :, :3], transforms[:, :22, :, :3], atol=1e-6)
    assert (poses.rotations.shape[1], motion.pose.shape[1]) == (52, 55)
    assert not poses.offsets.any()
    at_rest = dataclasses.replace(motion, pose=torch.zeros_like(motion.pose))
    np.testing.assert_allclose(with_face(at_rest, world).pose[:, 22:25], what.face, atol=1e-6)
    assert not with_face(at_rest, world).pose[:, :22].any()


def test_betas_of_other_lengths() -> None:
    assert model_betas(MODEL, None).tolist() == [0, 0, 0, 0]
    assert model_betas(MODEL, np.array([1.0, 2.0])).tolist() == [1, 2, 0, 0]
    assert model_betas(MODEL, np.arange(10.0)).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "wrong",
    [
        {"body_pose": np.zeros((5, 20, 3))}, {"face": np.zeros((4, 3, 3))}, {"translation": np.full((5, 3), np.nan)},
        {"frames": np.array([0, 1, 1, 2, 3])}, {"frames": np.arange(4)}, {"frame": "world"}, {"K": None},
        {"K": np.zeros((5, 3, 3))}, {"size": (0, 480)},
    ],
    ids=str,
)  # fmt: skip
def test_what_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match="body parameters"):
        dataclasses.replace(parameters(person.truth(), person.camera()), **wrong)
