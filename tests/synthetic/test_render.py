"""Pictures and ground truth: against the mesh rasteriser, between sides, threads, poses and views."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torch import Tensor

from soar.body import lbs
from soar.errors import InputError
from soar.geometry.meshes import vertex_normals
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.prior_inputs import CANONICAL_CENTRE
from soar.raster.mesh import rasterise_mesh
from soar.synthetic import background
from soar.synthetic.records import LAYERS
from soar.synthetic.render import Maps, Posed, Renderer, visible_points
from soar.synthetic.scene import People, Shot

BODY = LAYERS.index("body")


@pytest.fixture(scope="module")
def crowd(people: People) -> list[tuple[Posed, Shot, Maps, Maps]]:
    """Six people, three of each family, from all sides, with both maps."""
    out = []
    for i, (family, seed) in enumerate((f, s) for f in ("train", "benchmark") for s in (1, 2, 3)):
        posed = people.posed(family, seed)
        shot = people.framed(posed, azimuth=57.0 * i, elevation=8.0, size=96)
        out.append((posed, shot, *people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world, back=True)))
    return out


def _camera_space(points: np.ndarray, shot: Shot) -> Tensor:
    T = torch.from_numpy(shot.T_cam_from_world)
    return torch.from_numpy(points).double() @ T[:3, :3].T + T[:3, 3]


def test_posed_skin_equals_the_body_floors(people: People) -> None:
    subject = people.subject("train", 4)
    pose = people.pose(subject)
    posed = people.renderer.pose(people.renderer.dress(subject), pose.pose, pose.translation, people.light(subject))
    expected = lbs.pose_vertices(
        people.wardrobe.body, torch.from_numpy(subject.betas), axis_angle_to_matrix(torch.from_numpy(pose.pose)),
        torch.from_numpy(pose.translation),
    )  # fmt: skip
    np.testing.assert_allclose(people.renderer.body_vertices(posed), expected, atol=2e-5)


@pytest.mark.parametrize("side", ["front", "back"])
def test_naked_maps_equal_the_mesh_rasteriser(people: People, crowd: list, side: str) -> None:
    posed, shot, *_ = crowd[1]
    renderer = Renderer(people.wardrobe, dataclasses.replace(people.settings.render, samples=1))
    front, back = renderer.draw(posed, shot.pinhole, shot.T_cam_from_world, back=True)
    maps = front if side == "front" else back
    vertices = _camera_space(renderer.body_vertices(posed), shot)
    faces = torch.from_numpy(people.wardrobe.triangles("body", "eyes")).long()
    fragments = rasterise_mesh(vertices, faces, shot.pinhole, side)
    covered = fragments.face >= 0
    agree = covered == (maps.body_alpha > 0)
    assert agree.double().mean() > 0.999
    corners = faces[fragments.face[covered].long()]
    weights = fragments.barycentrics[covered].double()
    same = (maps.body_depth[covered].double() - fragments.depth[covered]).abs() < 1e-4
    assert same.double().mean() > 0.995  # the renderer draws no surface that faces the wrong way

    normals = torch.nn.functional.normalize(
        (vertex_normals(vertices, faces)[corners] * weights[..., None]).sum(1), dim=-1
    )
    seen = same & (normals[:, 2].abs() > 0.05)  # nearer to the rim normals are tilted to the drawn side
    cosine = (normals * maps.body_normal[:, covered].T).sum(1)[seen]
    assert (cosine > 0.999).double().mean() > 0.99  # of faces at the same depth either may be drawn
    assert cosine.min() > 0.9

    template = people.wardrobe.body.v_template.double()
    place = (template[corners] * weights[..., None]).sum(1) - torch.tensor(CANONICAL_CENTRE)
    np.testing.assert_allclose(maps.place[:, covered].T[same], place[same], atol=1e-4)


def test_normals_are_unit_and_on_their_side(crowd: list) -> None:
    for _, _, front, back in crowd:
        for maps, sign in ((front, -1), (back, 1)):
            for normal, alpha in ((maps.normal, maps.alpha), (maps.body_normal, maps.body_alpha)):
                covered = alpha > 0
                assert (sign * normal[2][covered] > 0).all()
                np.testing.assert_allclose(normal.norm(dim=0)[covered], 1, atol=1e-5)
                assert (normal[:, ~covered] == 0).all()


def test_back_maps_lie_pixel_by_pixel_on_the_front_maps(crowd: list) -> None:
    for _, _, front, back in crowd:
        assert (front.body_alpha != back.body_alpha).double().mean() < 2e-3
        assert (front.alpha != back.alpha).double().mean() < 4e-3
        both = (front.alpha > 0) & (back.alpha > 0)
        assert (back.depth[both] - front.depth[both] > -0.03).all()
        assert (back.depth[both] - front.depth[both]).median() > 0.05


def test_mask_is_the_union_of_the_layers(crowd: list) -> None:
    for posed, _, front, _ in crowd:
        assert torch.equal(front.layer >= 0, front.alpha > 0)
        assert torch.equal(front.depth > 0, front.alpha > 0)
        assert ((front.colour != 0).any(0) <= (front.alpha > 0)).all()
        worn = {"body", "eyes"} | {n for n in LAYERS[2:] if posed.dressed.subject.person.cloth(n).worn}
        drawn = {LAYERS[i] for i in front.layer.unique().tolist() if i >= 0}
        assert drawn <= worn
        assert len(drawn) > 2
        assert ((front.alpha * 4) % 1 == 0).all()  # two samples a side


def test_clothes_cover_the_body_they_are_worn_on(crowd: list) -> None:
    """Of the naked silhouette, what the clothed one misses is at most a rim of samples."""
    for _, _, front, _ in crowd:
        missed = (front.body_alpha - front.alpha).clamp_min(0).sum() / front.body_alpha.sum()
        assert missed < 0.01


def test_skin_never_shows_through_clothes(people: People) -> None:
    anchors, poked, looked = people.wardrobe.anchors, 0, 0
    for seed in range(24):
        posed = people.posed("train", seed)
        person = posed.dressed.subject.person
        top, legs, jacket = (person.cloth(name) for name in ("top", "trousers", "jacket"))
        if not (top.worn and legs.worn):
            continue
        for azimuth in (0, 130, 250):
            shot = people.framed(posed, azimuth, 5, 160)
            maps, _ = people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world)
            x, _, z = maps.place + torch.tensor(CANONICAL_CENTRE)[:, None, None]
            trunk = (
                (x.abs() < 0.11)
                & (z > legs.high + 0.03)
                & (z < anchors.chest - 0.06 - top.vee)
                & (maps.body_alpha == 1)
            )
            thighs = (x.abs() < 0.2) & (z < anchors.crotch + 0.02) & (z > legs.low + 0.05) & (maps.body_alpha == 1)
            drawn = maps.layer == BODY
            # The clothed surface is the trunk's own where its depth is that of the skin: a hand before it is no hole.
            own = (maps.depth - maps.body_depth).abs() < 1e-3
            poked += int((drawn & own & (trunk | thighs)).sum())
            looked += int((trunk | thighs).sum())
        assert jacket.worn in (0, 1)
    assert looked > 30_000
    assert poked == 0


def test_same_seed_same_pixels_for_any_number_of_threads(people: People) -> None:
    pictures = []
    for threads in (1, 2, 3):
        renderer = Renderer(people.wardrobe, people.settings.render, threads)
        posed = people.posed("train", 11)
        shot = people.framed(posed, 20, 5, 200)
        pictures.append(renderer.draw(posed, shot.pinhole, shot.T_cam_from_world, back=True))
    for other in pictures[1:]:
        for one, two in zip(pictures[0], other, strict=True):
            assert all(torch.equal(getattr(one, f.name), getattr(two, f.name)) for f in dataclasses.fields(Maps))


def test_canonical_coordinates_agree_between_poses(people: People) -> None:
    subject = people.subject("train", 6)
    dressed, found = people.renderer.dress(subject), []
    for take in (0, 1):
        pose = people.pose(subject, take)
        posed = people.renderer.pose(dressed, pose.pose, pose.translation, people.light(subject))
        shot = people.framed(posed, 0, 0, 256)
        maps, _ = people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world)
        body = people.wardrobe.layer_slices["body"]
        points, normals = posed.vertices[body], posed.normals[body]
        seen = visible_points(maps, shot.pinhole, shot.T_cam_from_world, points, normals, tolerance=0.01)
        at = _camera_space(points, shot).numpy()
        column = (shot.pinhole.fx * at[:, 0] / at[:, 2] + shot.pinhole.cx).astype(int).clip(0, 255)
        row = (shot.pinhole.fy * at[:, 1] / at[:, 2] + shot.pinhole.cy).astype(int).clip(0, 255)
        facing = (posed.normals[body] @ shot.T_cam_from_world[2, :3]) < -0.5
        found.append((seen & facing, maps.place[:, row, column].T.numpy()))
    both = found[0][0] & found[1][0]
    assert both.sum() > 1000
    apart = np.linalg.norm(found[0][1] - found[1][1], axis=1)[both]
    assert np.median(apart) < 0.01
    own = people.wardrobe.body.v_template.numpy() - np.array(CANONICAL_CENTRE)
    assert np.median(np.linalg.norm(found[0][1] - own, axis=1)[both]) < 0.01


def test_visible_points_are_those_nearest_to_the_camera(people: People, crowd: list) -> None:
    posed = crowd[0][0]
    shot = people.framed(posed, azimuth=30, elevation=8, size=400)
    front, _ = people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world)
    body = people.wardrobe.layer_slices["body"]
    points, normals = posed.vertices[body], posed.normals[body]
    seen = visible_points(front, shot.pinhole, shot.T_cam_from_world, points, normals, tolerance=0.01)
    exterior = np.unique(people.wardrobe.triangles("body", "eyes"))
    assert 0.2 < seen[exterior].mean() < 0.6
    # Brute force on a few hundred points: no triangle lies before a visible one by more than the tolerance.
    vertices, faces = _camera_space(points, shot).numpy(), people.wardrobe.triangles("body", "eyes")
    tri, n = vertices[faces], normals @ shot.T_cam_from_world[:3, :3].T
    rng = np.random.default_rng(0)
    wrong = 0
    picked = rng.choice(exterior, 200, replace=False)
    for i in picked:
        p = vertices[i]
        u, v = tri[..., 0] / tri[..., 2] - p[0] / p[2], tri[..., 1] / tri[..., 2] - p[1] / p[2]
        w = np.stack(
            [u[:, (k + 1) % 3] * v[:, (k + 2) % 3] - u[:, (k + 2) % 3] * v[:, (k + 1) % 3] for k in range(3)], 1
        )
        hit = ((w >= 0).all(1) | (w <= 0).all(1)) & ~(faces == i).any(1)
        share = w[hit] / w[hit].sum(1, keepdims=True)
        nearest = (1 / (share / tri[hit, :, 2]).sum(1)).min(initial=np.inf)
        facing = -np.dot(n[i], p) / np.linalg.norm(p)
        if facing < 0:
            assert not seen[i]
        elif facing > 0.15:  # at outlines the smooth normal decides
            wrong += (p[2] < nearest + 0.01) != bool(seen[i])
    assert wrong <= 0.03 * len(picked)


def test_backgrounds_fill_what_the_person_leaves(crowd: list) -> None:
    _, _, front, _ = crowd[0]
    grey = background.plain(96, 96)
    picture = background.composed(front, grey)
    assert torch.equal(picture[:, front.alpha == 0], grey[:, front.alpha == 0])
    one, two = (background.procedural(96, 96, np.random.default_rng(seed)) for seed in (0, 1))
    assert one.shape == (3, 96, 96)
    assert one.min() >= 0
    assert one.max() <= 1
    assert (one - two).abs().mean() > 0.05


def test_arrays_that_do_not_fit_are_named(people: People) -> None:
    dressed = people.renderer.dress(people.subject("train", 0))
    with pytest.raises(InputError, match="pose does not fit"):
        people.renderer.pose(dressed, np.zeros((3, 3)), np.zeros(3), people.light(dressed.subject))
    short = dataclasses.replace(dressed.subject, betas=np.zeros(2))
    with pytest.raises(InputError, match="shape does not fit"):
        people.renderer.dress(short)
