"""The body's planes that priors are told: those the bundled prior was taught with, whatever axes a body has."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from torch import Tensor

from soar.body.lbs import pose_vertices
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.prior_inputs import BODY, CANONICAL_CENTRE, NORMAL, PLACE
from soar.priors.geometry import BodyGeometry, enlarged
from soar.raster import Pinhole
from soar.synthetic.scene import People
from tests.avatar import toy
from tests.synthetic.conftest import people

__all__ = ["people"]  # a fixture

SIZE = 64


@pytest.mark.parametrize(("family", "seed", "azimuth"), [("train", 1, 0), ("train", 2, 70), ("benchmark", 3, 200)])
def test_planes_are_those_of_the_renderer(people: People, family: str, seed: int, azimuth: float) -> None:
    posed = people.posed(family, seed)
    shot = people.framed(posed, azimuth, 8, SIZE)
    maps, _ = people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world)
    body = BodyGeometry(people.wardrobe.body)
    vertices = torch.from_numpy(people.renderer.body_vertices(posed))
    T = torch.from_numpy(shot.T_cam_from_world).float()
    normals = body.normals(vertices) @ T[:3, :3].T
    planes = body.planes(vertices @ T[:3, :3].T + T[:3, 3], normals, shot.pinhole)
    assert planes.shape == (7, SIZE, SIZE)
    assert planes.dtype == torch.float32

    place, normal, alpha = planes[PLACE], planes[NORMAL], planes[BODY][0]
    assert (alpha == maps.body_alpha).double().mean() > 0.999
    both = (alpha > 0) & (maps.body_alpha > 0)
    assert both.sum() > 300
    apart = (place - maps.place).norm(dim=0)[both]
    assert (apart < 1e-4).double().mean() > 0.995
    assert (normal[2][both] < 0).all()
    torch.testing.assert_close(normal.norm(dim=0)[both], torch.ones(int(both.sum())), atol=1e-5, rtol=0)
    cosine = (normal * maps.body_normal).sum(0)[both]
    assert (cosine > 0.999).double().mean() > 0.99
    assert cosine.min() > 0.9  # at the rim too, where smooth normals lean over the edge
    assert (planes[:, alpha == 0] == 0).all()


def posed_toy() -> tuple[Tensor, Tensor]:
    """Vertices and normals of the toy body in front of its camera."""
    body, motion = toy.body(), toy.motion()
    vertices = pose_vertices(body, motion.betas, motion.rotations[1], motion.translation[1])
    T = toy.camera(0.4)
    return vertices @ T[:3, :3].T + T[:3, 3], BodyGeometry(body).normals(vertices) @ T[:3, :3].T


def test_the_body_s_own_axes_do_not_matter() -> None:
    body = toy.body()
    turn = axis_angle_to_matrix(torch.tensor([0.4, -1.1, 0.7]))
    turned = {name: getattr(body, name) @ turn.T for name in ("v_template", "up", "front", "left")}
    other = dataclasses.replace(body, **turned)
    assert (other.v_template - body.v_template).abs().max() > 0.3
    first, second = (BodyGeometry(model).planes(*posed_toy(), toy.PINHOLE) for model in (body, other))
    torch.testing.assert_close(first, second, atol=1e-5, rtol=0)
    # x to the left, y backward, z up, about the centre: the crown of the toy is at z = 1.1.
    crown = int(body.v_template[:, 2].argmax())
    expected = body.v_template[crown] - torch.tensor(CANONICAL_CENTRE)
    for model in (body, other):
        torch.testing.assert_close(BodyGeometry(model).place[crown], expected, atol=1e-5, rtol=0)


def test_interior_faces_are_not_drawn() -> None:
    body = toy.body()
    above = (body.v_template[body.faces][..., 2] > 0.5).all(1)
    headless = dataclasses.replace(body, interior=above)
    whole, half = (BodyGeometry(model).planes(*posed_toy(), toy.PINHOLE)[BODY] for model in (body, headless))
    assert 0.5 * whole.sum() < half.sum() < 0.7 * whole.sum()  # through the open top its inside is seen


def test_a_body_out_of_the_picture_leaves_zeros() -> None:
    vertices, normals = posed_toy()
    planes = BodyGeometry(toy.body()).planes(vertices + torch.tensor([9.0, 0, 0]), normals, toy.PINHOLE)
    assert (planes == 0).all()


def test_enlarged_shows_the_same_with_more_pixels() -> None:
    pinhole = Pinhole(fx=100.0, fy=110.0, cx=31.0, cy=17.0, width=64, height=32)
    larger = enlarged(pinhole, 2)
    assert (larger.width, larger.height) == (128, 64)
    point = np.array([0.1, -0.2, 3.0])
    before, after = ((p.fx * point[0] / point[2] + p.cx, p.fy * point[1] / point[2] + p.cy) for p in (pinhole, larger))
    assert after == pytest.approx((2 * before[0], 2 * before[1]))
    assert enlarged(larger, 0.5) == pinhole
