from __future__ import annotations

import numpy as np
import torch
import trimesh

from soar.geometry.meshes import compact, edges, face_normals, subdivide, vertex_normals


def test_subdivision_counts_and_surface_are_kept() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    faces, vertices = subdivide(mesh.faces, mesh.vertices)
    count = len(edges(mesh.faces))
    assert len(vertices) == len(mesh.vertices) + count
    assert len(faces) == 4 * len(mesh.faces)
    child = trimesh.Trimesh(vertices, faces, process=False)
    assert child.is_watertight
    assert np.isclose(child.area, mesh.area)
    assert np.isclose(child.volume, mesh.volume)  # the same winding, too


def test_normals_point_outwards_and_match_trimesh() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    normals = vertex_normals(vertices, faces)
    assert ((normals * vertices).sum(-1) > 0.99).all()
    unit = torch.nn.functional.normalize(face_normals(vertices, faces), dim=-1)
    assert torch.allclose(unit, torch.tensor(mesh.face_normals), atol=1e-6)


def test_normals_of_a_batch_equal_those_of_its_members() -> None:
    mesh = trimesh.creation.box()
    vertices = torch.tensor(np.stack([mesh.vertices, 2 * mesh.vertices + 1]))
    faces = torch.tensor(mesh.faces)
    assert torch.allclose(vertex_normals(vertices, faces)[1], vertex_normals(vertices[1], faces))


def test_compact_drops_unused_vertices() -> None:
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    kept, used = compact(faces, np.array([False, True]))
    assert used.tolist() == [2, 3, 4]
    assert kept.tolist() == [[0, 1, 2]]
