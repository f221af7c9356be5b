"""The mesh z-buffer: native against reference, and both against analytic surfaces."""

import numpy as np
import pytest
import torch

from soar.errors import InputError
from soar.raster import Pinhole, has_native, rasterise_mesh
from tests.raster.scenes import VIEW, sphere

BACKENDS = ["reference", pytest.param("native", marks=pytest.mark.skipif(not has_native(), reason="no native library"))]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("side", ["front", "back"])
def test_sphere_depth(backend, side):
    vertices, faces = sphere(5)
    got = rasterise_mesh(vertices, faces, VIEW, side, backend)
    rows, columns = torch.meshgrid(torch.arange(80) + 0.5, torch.arange(96) + 0.5, indexing="ij")
    ray = torch.stack([(columns - VIEW.cx) / VIEW.fx, (rows - VIEW.cy) / VIEW.fy, torch.ones(80, 96)], -1)
    # |t ray - (0, 0, 3)|^2 = 0.25; z = t
    a, b, c = (ray * ray).sum(-1), 3.0, 9.0 - 0.25
    discriminant = b * b - a * c
    root = discriminant.clamp_min(0).sqrt() * (1 if side == "back" else -1)
    inner = discriminant > 0.05  # away from the rim, where the polyhedron differs from the sphere
    torch.testing.assert_close(got.depth[inner], ((b + root) / a)[inner], atol=2e-3, rtol=0)
    hit = got.face >= 0
    assert not (hit & (discriminant < 0)).any()
    assert torch.isinf(got.depth[~hit]).all()
    assert not got.barycentrics[~hit].any()
    # Barycentrics place the point that projects to the pixel centre.
    point = (vertices[faces[got.face[hit].long()]] * got.barycentrics[hit][..., None]).sum(1)
    torch.testing.assert_close(point, ray[hit] * got.depth[hit][:, None], atol=2e-5, rtol=0)


@pytest.mark.skipif(not has_native(), reason="no native library")
@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("size", [(96, 80), (33, 17), (1, 1)])
def test_native_equals_reference(side, size):
    g = torch.Generator().manual_seed(0)
    centres = torch.rand(400, 1, 3, generator=g) * torch.tensor([1.6, 1.4, 2.0]) + torch.tensor([-0.8, -0.7, -0.2])
    vertices = (centres + 0.2 * torch.randn(400, 3, 3, generator=g)).reshape(-1, 3)  # some behind the camera
    faces = torch.arange(1200).reshape(400, 3)
    pinhole = Pinhole(size[0] * 0.9, size[0] * 0.9, size[0] / 2, size[1] / 2, *size)
    expected, got = (rasterise_mesh(vertices, faces, pinhole, side, b) for b in ("reference", "native"))
    assert torch.equal(got.face, expected.face)
    torch.testing.assert_close(got.depth, expected.depth)
    torch.testing.assert_close(got.barycentrics, expected.barycentrics)
    assert size == (1, 1) or len(expected.face.unique()) > 10


@pytest.mark.parametrize("backend", BACKENDS)
def test_shared_edges_leave_no_gap_and_ties_go_to_the_first(backend):
    """Two triangles of a square whose diagonal runs exactly through pixel centres, twice over."""
    square = torch.tensor([[-1.0, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]])
    got = rasterise_mesh(square, faces, Pinhole(16.0, 16.0, 8.0, 8.0, 16, 16), "front", backend)
    assert set(got.face.unique().tolist()) == {0, 1}
    assert (got.face.diagonal() == 0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_numpy_empty_and_errors(backend):
    vertices, faces = sphere(1)
    got = rasterise_mesh(vertices.numpy().astype(np.float64), faces.numpy(), VIEW, "front", backend)
    assert (got.face >= 0).any()
    assert (rasterise_mesh(vertices, faces[:0], VIEW, "front", backend).face == -1).all()
    assert (rasterise_mesh(-vertices, faces, VIEW, "front", backend).face == -1).all()
    with pytest.raises(InputError, match="not there"):
        rasterise_mesh(vertices[:5], faces, VIEW, "front", backend)
