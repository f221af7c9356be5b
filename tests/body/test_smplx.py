"""The whole model against the official package, its gradients, and where the contour of the face runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from soar.body.openpose import FACE, INDEX, LIMBS, NAMES
from soar.body.smplx import EXTRA_VERTICES, OPENPOSE, SmplX, contour_rows
from soar.body.smplx_file import JOINTS, SmplxFile, read_smplx
from soar.geometry.rotations import axis_angle_to_matrix
from tests.body import official

GOLDEN = np.load(Path(__file__).parent / "data" / "smplx_golden.npz")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[int, SmplxFile]:
    """Both versions, read from files."""
    folder = tmp_path_factory.mktemp("smplx")
    found = {}
    for components in (20, 400):
        path = official.write(folder / f"SMPLX_{components}.npz", official.arrays(components, dtype=np.float32))
        found[components] = read_smplx(path)
        path.unlink()
    return found


@pytest.fixture(scope="module")
def models(files: dict[int, SmplxFile]) -> dict[int, SmplX]:
    return {
        components: SmplX.of(file, official.BETAS[components], official.EXPRESSION[components], torch.float64)
        for components, file in files.items()
    }


def posed(model: SmplX, given: dict[str, np.ndarray], **options: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices and joints of the arguments of the official package."""
    tensors = {name: torch.from_numpy(value).to(model.v_template) for name, value in given.items()}
    betas, expression, transl = (tensors.pop(name) for name in ("betas", "expression", "transl"))
    return model(betas, expression, model.full_pose(**tensors, **options), transl)


@pytest.mark.parametrize("case", official.CASES, ids=str)
def test_vertices_and_joints_are_the_official_package_s(models: dict[int, SmplX], case: tuple[int, Any, bool]) -> None:
    components, hands, flat = case
    given = official.parameters(components, hands)
    vertices, joints = posed(models[components], given, hands=hands, flat_hand_mean=flat)
    name = "_".join(map(str, case))
    assert joints.shape == (official.FRAMES, 144, 3)
    np.testing.assert_allclose(vertices[:, official.SUBSET], GOLDEN[f"{name}_vertices"], atol=1e-6, rtol=0)
    np.testing.assert_allclose(joints, GOLDEN[f"{name}_joints"], atol=1e-6, rtol=0)


def test_single_precision(files: dict[int, SmplxFile], models: dict[int, SmplX]) -> None:
    given = official.parameters(20, 12)
    double, single = (
        posed(model, given, hands=12, flat_hand_mean=True)
        for model in (models[20], SmplX.of(files[20], num_betas=10, num_expression=10))
    )
    assert single[0].dtype == torch.float32
    for a, b in zip(double, single, strict=True):
        torch.testing.assert_close(a.float(), b, atol=1e-5, rtol=0)


def test_the_golden_numbers_tell_every_argument_apart() -> None:
    """Each case moves what it should: else a wrong hand or a wrong split of the components would pass."""
    hand = JOINTS.index("left_index2")
    for components in (20, 400):
        for hands in (6, "full"):
            flat, mean = (GOLDEN[f"{components}_{hands}_{f}_joints"][:, hand] for f in (True, False))
            assert np.abs(flat - mean).max() > 0.01


def test_one_shape_for_all_frames_and_flat_hands_at_rest(models: dict[int, SmplX]) -> None:
    model = models[20]
    zero = torch.zeros(2, 3, dtype=torch.float64)
    betas, pose = torch.linspace(-1, 1, 10).double(), model.full_pose(zero, hands="full", flat_hand_mean=True)
    vertices, joints = model(betas, zero.new_zeros(10), pose, zero + 0.5)
    torch.testing.assert_close(vertices, (model.v_template + model.shapedirs @ betas + 0.5).expand(2, -1, 3))
    torch.testing.assert_close(joints[0, len(JOINTS) :][:21], vertices[0, list(EXTRA_VERTICES)])
    curled = model.full_pose(zero, hands=3, flat_hand_mean=False)
    torch.testing.assert_close(curled[0, 25:].flatten(), model.hand_mean.flatten())


def test_a_pose_of_another_size_is_refused(models: dict[int, SmplX]) -> None:
    with pytest.raises(ValueError, match=r"\(1, 45\) instead of \(1, 12\)"):
        models[20].full_pose(torch.zeros(1, 3), left_hand_pose=torch.zeros(1, 45), hands=12, flat_hand_mean=True)


def test_gradients(files: dict[int, SmplxFile]) -> None:
    model = SmplX.of(files[20], 2, 2, torch.float64)
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape: int) -> torch.Tensor:
        return (0.3 * torch.randn(*shape, generator=generator, dtype=torch.float64)).requires_grad_()

    weights = torch.randn(2, 144, 3, generator=generator, dtype=torch.float64)
    where = torch.randn(2, 3, generator=generator, dtype=torch.float64)

    def summary(betas, expression, orient, hand, transl):  # a few numbers that depend on everything
        pose = model.full_pose(orient, None, orient, left_hand_pose=hand, hands=3, flat_hand_mean=False)
        vertices, joints = model(betas, expression, pose, transl)
        return torch.stack([(joints * weights).sum(), (vertices.mean(1) * where).sum()])

    inputs = drawn(2), drawn(2, 2), drawn(2, 3), drawn(2, 3), drawn(2, 3)
    assert torch.autograd.gradcheck(summary, inputs)


@pytest.mark.parametrize(("degrees", "row"), [(0, 0), (20, 20), (-20, 59), (60, 39), (-39, 78), (-60, 78)])
def test_rows_of_the_contour(degrees: float, row: int) -> None:
    """The head turned by the neck, or with the whole body; in the other axes the sides would change places."""
    for joint in ("neck", "pelvis"):
        pose = torch.zeros(1, len(JOINTS), 3, dtype=torch.float64)
        pose[0, JOINTS.index(joint), 1] = -np.deg2rad(degrees)
        assert contour_rows(axis_angle_to_matrix(pose), "opengl").tolist() == [row]
        upside_down = axis_angle_to_matrix(pose)
        upside_down[:, 0] = torch.diag(torch.tensor([1.0, -1, -1], dtype=torch.float64)) @ upside_down[:, 0]
        assert contour_rows(upside_down, "opencv").tolist() == [row]
        if 0 < abs(degrees) < 39:
            assert contour_rows(upside_down, "opengl").tolist() != [row]


def test_openpose_table_pairs_names() -> None:
    fingers = {"little": "pinky"}
    for name, k in zip(NAMES[: FACE.start], OPENPOSE, strict=False):
        side, _, rest = name.partition("_")
        part, _, number = rest.partition("_")
        if number in ("1", "2", "3"):
            assert JOINTS[k] == f"{side}_{fingers.get(part, part)}{number}"
        elif name in [NAMES[limb] for limb in LIMBS]:
            assert JOINTS[k] == name
    assert len(OPENPOSE) == 135
    assert len(set(OPENPOSE)) == 133  # each wrist is a keypoint of the body and one of the hand
    assert OPENPOSE[INDEX["jaw_0"]] == 127
    assert OPENPOSE[INDEX["right_brow_0"]] == 76
