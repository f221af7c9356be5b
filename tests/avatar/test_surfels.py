"""The first avatar of a body, and the avatar's file."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from soar.artifacts import write_tensors
from soar.avatar.surfels import SCALE_RANGE, Avatar, canonical_vertices, from_body
from soar.errors import ArtifactError
from soar.geometry.meshes import edges
from tests.avatar import toy


@pytest.fixture
def avatar() -> Avatar:
    return from_body(toy.body(), toy.motion().betas, toy.avatar_settings())


def test_surfels_lie_on_the_body_and_face_outwards(avatar: Avatar) -> None:
    body = toy.body()
    assert len(avatar) == len(body.v_template)
    lower = avatar.positions[:, 2] < 0.3
    gradient = (body.v_template - torch.tensor([0, 0, 0.5])) / torch.tensor([0.15, 0.15, 0.6]) ** 2
    outward = torch.nn.functional.normalize(gradient, dim=-1)
    assert ((outward * avatar.normals).sum(-1)[lower] > 0.97).all()
    torch.testing.assert_close(avatar.normals.norm(dim=-1), torch.ones(len(avatar)))


def test_radius_is_the_mean_neighbour_distance(avatar: Avatar) -> None:
    distance = torch.cdist(avatar.positions.double(), avatar.positions.double()).sort(1).values[:, 1:4].mean(1)
    torch.testing.assert_close(avatar.scales.double(), distance.clamp(*SCALE_RANGE), atol=1e-6, rtol=1e-4)


def test_subdivision_adds_the_edges_and_interior_faces_leave(avatar: Avatar) -> None:
    body, betas = toy.body(), toy.motion().betas
    settings = dataclasses.replace(toy.avatar_settings(), subdivisions=1)
    V, F = len(body.v_template), len(body.faces)
    assert len(from_body(body, betas, settings)) == V + F * 3 // 2
    inside = body.v_template[body.faces].mean(1)[:, 2] > 0.9
    smaller = from_body(dataclasses.replace(body, interior=inside), betas, toy.avatar_settings())
    assert len(smaller) < len(avatar)
    assert smaller.positions[:, 2].max() < avatar.positions[:, 2].max()


def test_long_edges_get_a_surfel_in_their_middle(avatar: Avatar) -> None:
    body, betas = toy.body(), toy.motion().betas
    vertices = canonical_vertices(body, betas)
    pairs = edges(body.faces.numpy())
    length = (vertices[pairs[:, 0]] - vertices[pairs[:, 1]]).norm(dim=1)
    limit = float(length.quantile(0.9))
    denser = from_body(body, betas, dataclasses.replace(toy.avatar_settings(), longest_edge=limit))
    wide = pairs[(length > limit).numpy()]
    assert len(denser) == len(avatar) + len(wide)
    torch.testing.assert_close(denser.positions[len(avatar) :], vertices[wide].mean(1))


def test_file_round_trip(avatar: Avatar, tmp_path: Path) -> None:
    avatar.write(tmp_path / "a.safetensors")
    back = Avatar.read(tmp_path / "a.safetensors")
    assert back.neighbours == avatar.neighbours
    for name in ("positions", "quaternions", "scales", "colours", "occlusion", "rest_positions"):
        assert torch.equal(getattr(back, name), getattr(avatar, name)), name


@pytest.mark.parametrize("damage", ["layout", "missing", "shape", "truncated"])
def test_a_foreign_file_is_named(avatar: Avatar, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.safetensors"
    tensors = {
        n: getattr(avatar, n) for n in ("positions", "quaternions", "scales", "colours", "occlusion", "rest_positions")
    }
    layout = "other" if damage == "layout" else "soar-avatar-1"
    if damage == "missing":
        del tensors["scales"]
    if damage == "shape":
        tensors["colours"] = tensors["colours"][:-1]
    write_tensors(path, tensors, {"format": f"{layout} neighbours=5"})
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ArtifactError, match=r"a\.safetensors"):
        Avatar.read(path)


def test_replace_sets_normals_through_the_quaternions(avatar: Avatar) -> None:
    normals = torch.nn.functional.normalize(
        torch.randn(len(avatar), 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    torch.testing.assert_close(avatar.replace(normals=normals).normals, normals, atol=1e-5, rtol=0)
    assert np.isclose(avatar.replace(normals=normals).quaternions.norm(dim=-1), 1, atol=1e-5).all()
