"""What the stages that make or show avatars read, and the pictures and figures they share."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from soar.artifacts import read_npz, write_npz
from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.errors import ModelFileError
from soar.losses.lpips import Lpips
from soar.optimise.reconstruct import ReconstructSettings
from soar.optimise.views import Views
from soar.report.shots import Shot
from soar.stages._rig import Observed, Rig, agreement, canonical_shots, perceptual
from tests.avatar import toy as capsule
from tests.conftest import conf
from tests.report import toy

CFG = {"raster": dataclasses.asdict(capsule.RASTER)}
FRAMES = {"front": [0, 1, 2, 3], "back": [3, 1]}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Both cameras train, ``back`` first, whose two crops are of late frames and have intrinsics of their own."""
    folder = tmp_path_factory.mktemp("rig")
    files = toy.write_sequence(folder)
    sequence = Sequence.read(files["sequence"])
    dataclasses.replace(sequence, train=("back", "front"), eval=(), cameras=sequence.cameras[::-1]).write(
        files["sequence"]
    )
    crops = read_npz(files["crops"] / "back.npz")
    kept = {name: crops[name][FRAMES["back"]] for name in ("rgb", "alpha", "K", "frame_index")}
    kept["K"][:, 0, 2] += [5, -7]
    write_npz(files["crops"] / "back.npz", crops | kept)
    for number, (name, frames) in enumerate(FRAMES.items()):
        front = np.full((len(frames), 64, 64, 3), 10 * number, np.int8)
        write_npz(folder / "normals" / f"{name}.npz", {"front": front, "back": front + np.int8(1)})
    return files | {"normals": folder / "normals"}


@pytest.fixture(scope="module")
def observed(inputs: dict[str, Path]) -> Observed:
    return Observed.read(inputs, CFG)


# --- reading ----------------------------------------------------------------------------------------------------------


def test_a_rig_is_the_body_its_motion_and_the_node_raster(inputs: dict[str, Path]) -> None:
    other = {"raster": CFG["raster"] | {"lowpass_px2": 0.3, "cull": False}}
    rig = Rig.read(inputs, other)
    assert rig.raster == dataclasses.replace(capsule.RASTER, lowpass_px2=0.3, cull=False)
    expected = Articulation.of(capsule.body(), capsule.motion(toy.FRAMES))
    torch.testing.assert_close(rig.articulation.vertices, expected.vertices)
    torch.testing.assert_close(rig.articulation.transforms, expected.transforms)
    assert rig.articulation is rig.articulation  # made once
    puppet = rig.puppet(toy.avatar())
    assert puppet.articulation is rig.articulation
    assert puppet.raster == rig.raster


def test_training_cameras_come_in_the_order_of_the_sequence_with_their_crops(
    inputs: dict[str, Path], observed: Observed
) -> None:
    assert [view.camera for view in observed.views] == ["back", "front"]
    for number, view in zip((1, 0), observed.views, strict=True):
        crops = read_npz(inputs["crops"] / f"{view.camera}.npz")
        assert np.array_equal(view.rgb, crops["rgb"])
        assert np.array_equal(view.alpha, crops["alpha"])
        assert np.array_equal(view.T_cam_from_world, crops["T_cam_from_world"])
        assert view.frames.tolist() == FRAMES[view.camera]
        for i, K in enumerate(crops["K"]):
            assert dataclasses.astuple(view.pinhole(i)) == (K[0, 0], K[1, 1], K[0, 2], K[1, 2], 64, 64)
        assert (view.normals[:, 0] == 10 * number).all()
        assert (view.normals[:, 1] == 10 * number + 1).all()
    back = observed.views[0]
    assert back.pinhole(0).cx - back.pinhole(1).cx == 12


def test_evaluation_cameras_are_not_opened_nor_normals_where_the_stage_has_none(
    inputs: dict[str, Path], tmp_path: Path
) -> None:
    sequence = Sequence.read(inputs["sequence"])
    dataclasses.replace(sequence, train=("back",), eval=("front",)).write(tmp_path / "sequence.json")
    (tmp_path / "crops").mkdir()
    (tmp_path / "crops" / "back.npz").write_bytes((inputs["crops"] / "back.npz").read_bytes())
    given = {"sequence": tmp_path / "sequence.json", "crops": tmp_path / "crops"}
    given |= {name: inputs[name] for name in ("body_model", "body")}
    (view,) = Observed.read(given, CFG).views
    assert view.camera == "back"
    assert view.normals is None


@pytest.mark.parametrize(("lpips", "normal_lpips"), [(0.1, 0.0), (0.0, 0.1), (0.0, 0.0)])
def test_the_perceptual_distance_is_opened_where_it_has_a_weight(
    inputs: dict[str, Path], tmp_path: Path, lpips: float, normal_lpips: float
) -> None:
    options: Any = settings(ReconstructSettings, conf("reconstruct", "cpu"))
    weights = dataclasses.replace(options.weights, lpips=lpips, normal_lpips=normal_lpips)
    alex, vgg = (dataclasses.replace(options, weights=weights, lpips=net) for net in ("alex", "vgg"))
    if lpips or normal_lpips:
        assert isinstance(perceptual(inputs, alex), Lpips)
        with pytest.raises(ModelFileError, match=r"lpips_vgg\.safetensors"):
            perceptual(inputs, vgg)
    else:
        assert perceptual({"models": tmp_path / "nowhere"}, vgg) is None


# --- pictures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "back", "front"), [(2, [0, 1], [0, 3]), (1, [0], [0]), (9, [0, 1], [0, 1, 2, 3])])
def test_shots_are_spread_over_every_camera_s_time_and_seen_through_their_crops(
    observed: Observed, count: int, back: list[int], front: list[int]
) -> None:
    avatar = toy.avatar()
    shots = observed.shots(avatar, count)
    assert [(view.camera, i) for view, i, _ in shots] == [("back", i) for i in back] + [("front", i) for i in front]
    puppet = Puppet(avatar, Articulation.of(capsule.body(), capsule.motion(toy.FRAMES)), capsule.RASTER)
    for view, i, shot in shots:
        pinhole = capsule.PINHOLE
        if view.camera == "back":
            pinhole = dataclasses.replace(pinhole, cx=pinhole.cx + (5, -7)[i])
        expected = Shot.of(puppet.render(FRAMES[view.camera][i], view.T_cam_from_world, pinhole))
        np.testing.assert_allclose(shot.alpha, expected.alpha, atol=1e-5)
        np.testing.assert_allclose(shot.on_white(), expected.on_white(), atol=1e-5)


@pytest.mark.parametrize("count", [1, 4])
def test_the_canonical_avatar_is_seen_from_the_front_then_from_its_left(inputs: dict[str, Path], count: int) -> None:
    """The toy's front is -y and its left is +x."""
    rig, avatar = Rig.read(inputs, CFG), toy.avatar()
    x, y = avatar.normals[:, :1], avatar.normals[:, 1:2]
    sides = {"front": (1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "back": (0.0, 0.0, 1.0), "right": (1.0, 1.0, 0.0)}
    colour = {side: torch.tensor(value) for side, value in sides.items()}
    across = torch.where(x > 0, colour["left"], colour["right"])
    along = torch.where(y < 0, colour["front"], colour["back"])
    painted = avatar.replace(colours=torch.where(x.abs() > y.abs(), across, along))
    shots = canonical_shots(rig, painted, count, 100)
    assert len(shots) == count
    for shot, (side, wanted) in zip(shots, list(sides.items())[:count], strict=True):
        height, width = shot.alpha.shape
        assert height == 100
        middle = shot.colour[45:55, width // 2 - 2 : width // 2 + 2].mean((0, 1))
        np.testing.assert_allclose(middle, wanted, atol=0.02, err_msg=side)
        # All of it, upright: the person fills the picture but for its margin.
        shown = shot.alpha > 0.5
        rows = np.flatnonzero(shown.any(1))
        assert 2 <= rows[0] <= 12
        assert 88 <= rows[-1] <= 98
        assert not shown[:, [0, -1]].any()
        down = shot.normal[..., 1]
        assert down[:20][shown[:20]].mean() < -0.2
        assert down[80:][shown[80:]].mean() > 0.2
        assert shot.normal[50, width // 2, 2] < -0.9  # towards the camera
    # Occlusion is the avatar's own: its front was seen, its back was not.
    assert shots[0].occlusion[50, shots[0].alpha.shape[1] // 2] < 0.01
    if count == 4:
        assert shots[2].occlusion[50, shots[2].alpha.shape[1] // 2] > 0.99


# --- figures ----------------------------------------------------------------------------------------------------------


def known(overlapping: int, add: float) -> tuple[Views, int, Shot]:
    """A crop whose left half is the person, a shot whose ``overlapping`` middle columns are, brighter by ``add``."""
    alpha = np.zeros((2, 20, 20), np.uint8)
    alpha[1, :, :10] = 255
    crops = {
        "rgb": np.full((2, 20, 20, 3), 102, np.uint8),
        "alpha": alpha,
        "K": np.stack([np.eye(3)] * 2),
        "T_cam_from_world": np.eye(4),
        "frame_index": np.arange(2),
    }
    cover = np.zeros((20, 20), np.float32)
    cover[:, 10 - overlapping : 20 - overlapping] = 1
    blank = np.zeros((20, 20, 3), np.float32)
    return Views.of("x", crops), 1, Shot(np.full_like(blank, 0.4 + add), cover, blank, cover)


def test_agreement_is_the_mean_over_shots_of_overlap_and_of_the_whole_crop_on_white() -> None:
    overlap, fidelity = agreement([known(10, 0.1)])
    assert overlap == 1
    assert fidelity == pytest.approx(20 + 10 * math.log10(2), abs=1e-3)  # half of the crop is white in both
    moved, apart = agreement([known(5, 0.0)])
    assert moved == pytest.approx(1 / 3)
    assert apart == pytest.approx(-10 * math.log10(0.6**2 / 2), abs=1e-3)  # person against white in half of the crop
    both = agreement([known(10, 0.1), known(5, 0.0)])
    assert both == pytest.approx(((overlap + moved) / 2, (fidelity + apart) / 2))
