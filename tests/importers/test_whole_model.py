"""Archives against the whole SMPL-X model, posed by the conventions of the tool that wrote them: vertex by vertex."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from soar.body import lbs
from soar.body.parameters import HandSpace, in_world, matrices, motion_of
from soar.body.record import BodyModel
from soar.body.smplx import SmplX
from soar.body.smplx_file import read_smplx
from soar.body.smplx_record import SmplxSettings, build_record
from soar.importers.archive import Known
from soar.importers.registry import read_parameters
from tests.body import humanoid, official, stickman
from tests.importers import person, writers

CAMERA = person.camera()
SIZE = (CAMERA.width, CAMERA.height)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[SmplX, BodyModel]:
    """The model of a file of the official form, and its record."""
    file = read_smplx(official.write(tmp_path_factory.mktemp("smplx") / "SMPLX_NEUTRAL.npz", humanoid.arrays()))
    record = build_record(file, stickman.body(torch.float32), SmplxSettings("smplx", None, 10, "none"))
    return SmplX.of(file, 10, 0, torch.float64), record


def vertices_of(record: BodyModel, kind: str, path: Path) -> np.ndarray:
    (found,) = read_parameters(kind, path, Known(SIZE, None, HandSpace.of(record))).people
    motion = motion_of(in_world(found, record, CAMERA), record)
    return lbs.pose_vertices(record, motion.betas, motion.rotations, motion.translation).numpy()


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.from_numpy(np.asarray(x, np.float64)) for x in arrays]


def test_smplerx(both: tuple[SmplX, BodyModel], tmp_path: Path) -> None:
    """Hands from the mean hand, the translation added last."""
    model, record = both
    what = person.truth(3)
    writers.smplerx(tmp_path, what, CAMERA, HandSpace.of(record))
    orient, body, jaw, left, right = tensors(
        what.orient, what.body.reshape(3, 63), what.face[:, 0], *(what.hands - HandSpace.of(record).mean).swapaxes(0, 1)
    )
    eyes = tensors(what.face[:, 1], what.face[:, 2])
    pose = model.full_pose(orient, body, jaw, *eyes, left, right, hands="full", flat_hand_mean=False)
    betas, transl = tensors(np.concatenate([what.betas, np.zeros(6)]), what.transl)
    expected, _ = model(betas, betas.new_zeros(0), pose, transl)
    np.testing.assert_allclose(vertices_of(record, "smplerx", tmp_path), expected, atol=2e-5)


def test_easymocap(both: tuple[SmplX, BodyModel], tmp_path: Path) -> None:
    """Six coefficients a hand from the flat hand; the posed body turns about its origin."""
    model, record = both
    rng = np.random.default_rng(2)
    poses, shapes = rng.uniform(-0.3, 0.3, 87), rng.uniform(-1, 1, 10)
    poses[:3] = 0
    Rh, Th = np.array([2.9, 0.3, -0.2]), np.array([0.1, 0.2, 4.0])
    one = {"id": 0, "Rh": [Rh.tolist()], "Th": [Th.tolist()], "poses": [poses.tolist()], "shapes": [shapes.tolist()]}
    (tmp_path / "000000.json").write_text(json.dumps([one]))
    parts = np.split(poses, [3, 66, 72, 78, 81, 84])
    root, body, left, right, jaw, *eyes = tensors(*(part[None] for part in parts))
    pose = model.full_pose(root, body, jaw, *eyes, left, right, hands=6, flat_hand_mean=True)
    (betas,) = tensors(shapes)
    straight, _ = model(betas, betas.new_zeros(0), pose, betas.new_zeros(1, 3))
    expected = straight.numpy() @ matrices(Rh).T + Th
    np.testing.assert_allclose(vertices_of(record, "easymocap", tmp_path), expected, atol=2e-5)
