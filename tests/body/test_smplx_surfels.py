"""The paper's number of surfels: a mesh with the counts of SMPL-X's, subdivided twice."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import from_body
from soar.body.record import BodyModel
from soar.body.smplx_file import FACES, VERTICES
from soar.config import settings
from soar.geometry.meshes import edges
from tests.avatar import toy
from tests.conftest import conf

EDGES, BORDER, SURFELS = 31378, 32, 167_333
"""Edges of SMPL-X, those with one face only, and the paper's surfels."""

AROUND = 32


def capsule(rings: int, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere of ``rings`` circles of 32 vertices and a pole, or both poles where ``closed``."""
    up = np.pi * np.arange(1, rings + 1) / (rings + 1)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    circle = np.stack([np.outer(np.sin(up), f(angle)) for f in (np.cos, np.sin)], -1)
    height = np.broadcast_to(np.cos(up)[:, None, None], (rings, AROUND, 1))
    poles = np.array([[0.0, 0, 1], [0, 0, -1]])[: 1 + closed]
    vertices = np.concatenate([np.concatenate([circle, height], -1).reshape(-1, 3), poles])
    j = np.arange(AROUND)
    following, top = (j + 1) % AROUND, rings * AROUND
    faces = [np.stack([np.full(AROUND, top), j, following], 1)]
    for start in AROUND * np.arange(rings - 1):
        below = start + AROUND
        faces += [np.stack([start + j, below + j, start + following], 1)]
        faces += [np.stack([start + following, below + j, below + following], 1)]
    if closed:
        last = (rings - 1) * AROUND
        faces.append(np.stack([np.full(AROUND, top + 1), last + following, last + j], 1))
    return vertices, np.concatenate(faces)


def split(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first faces become three each, round a new vertex in their middle."""
    a, b, c = faces[:count].T
    middle = len(vertices) + np.arange(count)
    new = np.concatenate([np.stack(corner, 1) for corner in ((a, b, middle), (b, c, middle), (c, a, middle))])
    return np.concatenate([vertices, vertices[faces[:count]].mean(1)]), np.concatenate([faces[count:], new])


def body() -> BodyModel:
    """A trunk that is open at one end, as SMPL-X is at its mouth, and two closed eyeballs."""
    parts = [split(*capsule(293, closed=False), 6), capsule(17, closed=True), capsule(17, closed=True)]
    vertices, faces = [], []
    for i, (v, f) in enumerate(parts):
        faces.append(f + sum(map(len, vertices)))
        vertices.append(v * (1, 0.03, 0.03)[i] + np.array([0, 2.0 * i, 0]))
    points = torch.from_numpy(np.concatenate(vertices)).float()
    triangles = torch.from_numpy(np.concatenate(faces))
    return dataclasses.replace(
        toy.body(), v_template=points, shapedirs=torch.zeros(len(points), 3, 1), faces=triangles,
        weights=torch.eye(3)[[0] * len(points)], interior=torch.zeros(len(triangles), dtype=torch.bool),
    )  # fmt: skip


def test_the_mesh_has_the_counts_of_smplx() -> None:
    model = body()
    faces = model.faces.numpy()
    assert (len(model.v_template), len(faces)) == (VERTICES, FACES)
    assert len(np.unique(faces)) == VERTICES
    assert len(edges(faces)) == EDGES
    _, used = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True)
    assert (used == 1).sum() == BORDER
    assert used.max() == 2
    assert SURFELS == VERTICES + 3 * EDGES + 3 * FACES


def test_the_paper_s_avatar_has_as_many_surfels() -> None:
    options = settings(AvatarSettings, conf("avatar", "paper"), "avatar")
    avatar = from_body(body(), torch.zeros(1), options)
    assert len(avatar) == SURFELS
    assert len(avatar.quaternions) == len(avatar.scales) == SURFELS
