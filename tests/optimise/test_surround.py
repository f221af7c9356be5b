"""Four cameras round a body and the image prompt: sides and signs, framing, and pixels that show what they should."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import torch
from torch import Tensor

from soar.config import settings
from soar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from soar.networks.prior_inputs import BODY, NORMAL, PLACE
from soar.optimise.surround import Look, Surround, SurroundSettings
from soar.optimise.views import Views
from soar.raster import Pinhole
from tests.avatar import toy
from tests.conftest import conf
from tests.optimise import scene

SIZE = 64
SETTINGS = dataclasses.replace(
    settings(SurroundSettings, conf("refine", "cpu")["views"], "refine.views"),
    elevation=(-5.0, 15.0),
    fov=(20.0, 40.0),
    fill=(0.8, 0.92),
    prompt_fill=0.85,
    samples=2,
)
UP = np.array([0.0, 0.0, 2.0])


@pytest.fixture(scope="module")
def surround() -> Surround:
    return Surround(toy.body(), toy.motion(), UP, SETTINGS, SIZE)


@pytest.fixture(scope="module")
def views() -> Views:
    return scene.film(scene.truth())


def centre(T: Tensor) -> np.ndarray:
    """(3,) where a camera stands."""
    return (-T[:3, :3].T @ T[:3, 3]).numpy()


def across(vector: np.ndarray) -> np.ndarray:
    """The horizontal part, of length 1."""
    return vector[:2] / np.linalg.norm(vector[:2])


def projected(points: Tensor, T: Tensor, pinhole: Pinhole) -> Tensor:
    """(N, 2) pixels of world points."""
    p = points @ T[:3, :3].T + T[:3, 3]
    assert (p[:, 2] > 0).all()
    return torch.stack([pinhole.fx * p[:, 0] / p[:, 2] + pinhole.cx, pinhole.fy * p[:, 1] / p[:, 2] + pinhole.cy], 1)


def seen_body(surround: Surround, frame: int, look: Look) -> Tensor:
    return projected(surround.posed(frame)[0], look.T_cam_from_world, look.pinhole)


# --- the four cameras -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("azimuth", [0.0, 0.7, -2.0])
def test_azimuth_0_is_the_training_camera_and_90_the_left_of_who_faces_it(surround: Surround, azimuth: float) -> None:
    """The toy looks at a camera of azimuth 0 along +y; its left hand is at +x then."""
    T = toy.camera(azimuth)
    looks = surround.looks(0, T, torch.tensor([0.0, 0.5, 0.5, 0.5]))
    assert [look.azimuth for look in looks] == [0, 90, 180, 270]
    middle = surround.posed(0)[0].mean(0).numpy()
    ways = [across(centre(look.T_cam_from_world) - middle) for look in looks]
    front = across(centre(T) - middle)
    left = np.array([-front[1], front[0]])  # a quarter on, counter-clockwise seen from above
    if azimuth == 0:
        np.testing.assert_allclose(left, toy.body().left[:2], atol=0.02)
    for way, expected in zip(ways, (front, left, -front, -left), strict=True):
        np.testing.assert_allclose(way, expected, atol=0.03)  # about the box's middle, not the vertices'
    radii = [np.linalg.norm(centre(look.T_cam_from_world) - middle) for look in looks]
    np.testing.assert_allclose(radii, radii[0], rtol=0.02)


def test_the_first_camera_stands_anywhere_in_the_first_quarter(surround: Surround) -> None:
    for turn in (0.0, 0.25, 1.0):
        looks = surround.looks(1, toy.camera(), torch.tensor([turn, 0.5, 0.5, 0.5]))
        np.testing.assert_allclose([look.azimuth for look in looks], 90 * turn + 90 * np.arange(4))
        aims = np.stack([look.T_cam_from_world[2, :2].numpy() for look in looks])
        aims /= np.linalg.norm(aims, axis=1, keepdims=True)
        expected = [[np.sin(a), -np.cos(a)] for a in np.deg2rad(90 * turn + 90 * np.arange(4))]
        np.testing.assert_allclose(-aims, expected, atol=0.01)


@pytest.mark.parametrize(("level", "degrees"), [(0.0, -5.0), (0.25, 0.0), (1.0, 15.0)])
def test_elevation_is_upward(surround: Surround, level: float, degrees: float) -> None:
    vertices = surround.posed(2)[0]
    height = float(vertices[:, 2].max() + vertices[:, 2].min()) / 2
    for look in surround.looks(2, toy.camera(), torch.tensor([0.3, level, 0.5, 0.5])):
        assert look.elevation == pytest.approx(degrees, abs=1e-5)
        T = look.T_cam_from_world
        target = T[:3, :3] @ torch.tensor([0.0, 0.0, height]) + T[:3, 3]
        distance = float(target[2])
        assert centre(T)[2] - height == pytest.approx(distance * np.sin(np.deg2rad(degrees)), abs=0.02)
        assert float(T[1, 2]) < 0  # up in the world is up in the picture


def test_field_of_view_and_fill_are_what_was_drawn(surround: Surround) -> None:
    for (lens, fov), (share, fill) in itertools.product(((0.0, 20.0), (1.0, 40.0)), ((0.0, 0.8), (1.0, 0.92))):
        looks = surround.looks(0, toy.camera(), torch.tensor([0.2, 0.25, lens, share]))
        for look in looks:
            assert 2 * np.rad2deg(np.arctan(SIZE / 2 / look.pinhole.fx)) == pytest.approx(fov, abs=1e-4)
            assert (look.pinhole.cx, look.pinhole.cy, look.pinhole.width) == (SIZE / 2, SIZE / 2, SIZE)
            at = seen_body(surround, 0, look)
            larger = float((at.max(0).values - at.min(0).values).max()) / SIZE
            assert larger == pytest.approx(fill, abs=0.03)


@pytest.mark.parametrize("frame", range(4))
def test_the_whole_body_is_inside_for_all_corners_of_the_draws(surround: Surround, frame: int) -> None:
    for corner in itertools.product((0.0, 1.0), repeat=4):
        for look in surround.looks(frame, toy.camera(0.4), torch.tensor(corner)):
            at = seen_body(surround, frame, look)
            assert at.min() > 0, corner
            assert at.max() < SIZE, corner


def test_any_axis_may_be_up(surround: Surround) -> None:
    """A world turned as a whole, about the body's root, changes nothing in the pictures."""
    motion, T = toy.motion(), torch.eye(4)
    T[:3, :3] = turn = axis_angle_to_matrix(torch.tensor([1.2, -0.4, 0.3]))
    pose = motion.pose.clone()
    pose[:, 0] = matrix_to_axis_angle(turn @ motion.rotations[:, 0])
    turned = Surround(toy.body(), dataclasses.replace(motion, pose=pose), turn.numpy() @ UP, SETTINGS, SIZE)
    draw = torch.tensor([0.1, 0.9, 0.4, 0.6])
    one = surround.looks(3, toy.camera(0.3), draw)
    other = turned.looks(3, toy.camera(0.3) @ T.T, draw)
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(seen_body(surround, 3, a), seen_body(turned, 3, b), atol=1e-2, rtol=0)


def test_planes_and_fine_pictures_show_the_same_view(surround: Surround) -> None:
    look = surround.looks(1, toy.camera(), torch.full((4,), 0.5))[1]
    planes = surround.planes(1, look.T_cam_from_world, look.pinhole)
    at = seen_body(surround, 1, look)
    rows, columns = (planes[BODY][0] > 0).any(1).nonzero(), (planes[BODY][0] > 0).any(0).nonzero()
    box = torch.tensor([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    expected = torch.cat([at.min(0).values, at.max(0).values])
    torch.testing.assert_close(box.float(), expected, atol=1.5, rtol=0)
    assert float(planes[NORMAL][2].max()) <= 0
    fine = surround.fine(look)
    torch.testing.assert_close(projected(surround.posed(1)[0], look.T_cam_from_world, fine), SETTINGS.samples * at)
    assert (fine.width, fine.height) == (SETTINGS.samples * SIZE, SETTINGS.samples * SIZE)


# --- the image prompt -------------------------------------------------------------------------------------------------


def box(alpha: np.ndarray) -> np.ndarray:
    """(4,) left, top, right, bottom, pixels, of what a mask in [0, 1] covers more than half."""
    rows, columns = np.flatnonzero((alpha > 0.5).any(1)), np.flatnonzero((alpha > 0.5).any(0))
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1])


def test_the_prompt_is_a_square_about_the_mask(surround: Surround, views: Views) -> None:
    for index in range(len(views)):
        condition = surround.conditions(views, index, ["colour"], "words")[0]
        assert (condition.domain, condition.text) == ("colour", "words")
        assert condition.picture.shape == (3, SIZE, SIZE)
        alpha = condition.alpha[0].numpy()
        left, top, right, bottom = box(alpha)
        assert max(right - left, bottom - top) / SIZE == pytest.approx(SETTINGS.prompt_fill, abs=1.5 / SIZE)
        assert abs(left + right - SIZE) <= 2
        assert abs(top + bottom - SIZE) <= 2
        body = condition.geometry[BODY][0].numpy() > 0.5
        person = alpha > 0.5
        assert (body & person).sum() / body.sum() > 0.99  # the person is a centimetre fatter, and blurred
        assert (body & person).sum() / person.sum() > 0.75
        middle = (box(body)[:2] + box(body)[2:]) / 2
        np.testing.assert_allclose(middle, SIZE / 2, atol=1.5)


def test_the_prompt_shows_the_photograph_multiplied_by_alpha(surround: Surround, views: Views) -> None:
    condition = surround.conditions(views, 0, ["colour"], "")[0]
    picture, alpha = condition.picture.numpy(), condition.alpha.numpy()
    assert (picture[:, alpha[0] == 0] == 0).all()
    assert (picture <= alpha + 1e-6).all()
    x0, y0, x1, y1 = box(views.alpha[0] / 255)
    scale = SETTINGS.prompt_fill * SIZE / max(x1 - x0, y1 - y0)
    opaque = alpha[0] == 1
    rows, columns = np.nonzero(opaque)
    x = ((columns + 0.5 - SIZE / 2) / scale + (x0 + x1) / 2).astype(int)
    y = ((rows + 0.5 - SIZE / 2) / scale + (y0 + y1) / 2).astype(int)
    away = np.abs(picture[:, opaque].T - views.rgb[0][y, x] / 255).max(1)
    assert (away < 0.1).mean() > 0.9  # the rest lies where one colour meets another


def test_body_points_are_where_the_prompt_s_geometry_has_them(surround: Surround, views: Views) -> None:
    T = views.T_cam_from_world
    for index in (1, 3):
        condition = surround.conditions(views, index, ["colour"], "")[0]
        vertices, normals = surround.posed(index)
        at = projected(vertices, T, Pinhole.from_K(views.K[index], *views.size[::-1]))
        x0, y0, x1, y1 = box(views.alpha[index] / 255)
        scale = SETTINGS.prompt_fill * SIZE / max(x1 - x0, y1 - y0)
        inside = scale * (at - torch.tensor([x0 + x1, y0 + y1]) / 2) + SIZE / 2
        eye = torch.from_numpy(centre(T))
        facing = ((normals * torch.nn.functional.normalize(vertices - eye, dim=1)).sum(1) < -0.7).nonzero()[:, 0]
        assert len(facing) > 50
        column, row = inside[facing].floor().long().T
        assert (condition.geometry[BODY][0, row, column] > 0).all()
        apart = condition.geometry[PLACE][:, row, column].T - surround.geometry.place[facing]
        pixel = 3.0 / (scale * scene.PINHOLE.fx)  # metres
        # Within a pixel of rounding the window and one of looking it up; depth changes more where it slants.
        assert (apart[:, [0, 2]].norm(dim=1) < 2.5 * pixel).all()
        assert apart.mean(0).abs().max() < 0.5 * pixel


def test_normal_prompts_are_the_estimated_front_map(surround: Surround, views: Views) -> None:
    condition = surround.conditions(views, 2, ["normal"], "")[0]
    alpha = condition.alpha
    assert condition.domain == "normal"
    assert (condition.picture >= 0).all()
    assert (condition.picture <= alpha + 1e-6).all()
    opaque = alpha[0] == 1
    normal = (2 * condition.picture - alpha)[:, opaque]
    torch.testing.assert_close(normal.norm(dim=0), torch.ones(normal.shape[1]), atol=1e-3, rtol=0)
    assert (normal[2] < 0).all()
    # In half covered pixels too, divided by alpha.
    rim = (alpha[0] > 0.2) & (alpha[0] < 0.8)
    assert rim.any()
    lengths = (2 * condition.picture[:, rim] / alpha[:, rim] - 1).norm(dim=0)
    torch.testing.assert_close(lengths, torch.ones_like(lengths), atol=1e-3, rtol=0)
    # The map is the person's, and that is the body's up to a centimetre.
    body = condition.geometry
    both = opaque & (body[BODY][0] == 1)
    cosine = ((2 * condition.picture - alpha) * body[NORMAL]).sum(0)[both]
    assert cosine.median() > 0.95
    assert torch.equal(condition.alpha, surround.conditions(views, 2, ["colour"], "")[0].alpha)


def shifted(views: Views, columns: int, rows: int) -> Views:
    """The same crops with their contents moved, what leaves them lost; cameras move along."""
    height, width = views.size
    moved = {}
    for name in ("rgb", "alpha"):
        images = getattr(views, name)
        out = np.zeros_like(images)
        to = [slice(max(s, 0), n + min(s, 0)) for s, n in ((rows, height), (columns, width))]
        of = [slice(max(-s, 0), n - max(s, 0)) for s, n in ((rows, height), (columns, width))]
        out[:, to[0], to[1]] = images[:, of[0], of[1]]
        moved[name] = out
    K = views.K.astype(float).copy()
    K[:, :2, 2] += columns, rows
    return dataclasses.replace(views, **moved, K=K)


def test_a_square_that_leaves_the_crop_is_padded_with_nothing(surround: Surround, views: Views) -> None:
    x0, y0, *_ = box(views.alpha[0] / 255)
    corner = shifted(views, -int(x0), -int(y0))  # the person touches two sides of the crop, nothing is lost
    whole, cut = (surround.conditions(v, 0, ["colour"], "")[0] for v in (views, corner))
    torch.testing.assert_close(cut.picture, whole.picture, atol=1e-5, rtol=0)
    torch.testing.assert_close(cut.alpha, whole.alpha, atol=1e-5, rtol=0)
    torch.testing.assert_close(cut.geometry, whole.geometry, atol=1e-3, rtol=0)

    half = shifted(views, -int(x0) - 15, 0)  # a part of the person is lost
    condition = surround.conditions(half, 0, ["colour"], "")[0]
    left, top, right, bottom = box(condition.alpha[0].numpy())
    assert max(right - left, bottom - top) / SIZE == pytest.approx(SETTINGS.prompt_fill, abs=1.5 / SIZE)
    beyond = condition.alpha[0, :, : left - 2]
    assert beyond.shape[1] > 5
    assert (beyond == 0).all()
    assert (condition.picture[:, :, : left - 2] == 0).all()
    body = condition.geometry[BODY][0]
    assert body[:, : left - 2].sum() > 20  # the body goes on where the photograph ends


def test_a_prompt_without_a_person_is_empty(surround: Surround, views: Views) -> None:
    nobody = dataclasses.replace(views, alpha=np.zeros_like(views.alpha))
    for domain in ("colour", "normal"):
        condition = surround.conditions(nobody, 0, [domain], "")[0]
        assert (condition.alpha == 0).all()
        assert (condition.picture == 0).all()
        assert (condition.geometry[BODY] > 0).any()
