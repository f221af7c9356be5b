"""The three stages that make an avatar, one after the other, on the toy sequence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from soar.artifacts import read_json, read_npz, sha256_file, write_npz
from soar.avatar.surfels import Avatar
from soar.errors import ArtifactError
from soar.health import Health
from soar.stages import Job, occlusion, paint, reconstruct
from tests.conftest import conf
from tests.report import toy

STEPS = 12


def options() -> dict[str, Any]:
    """The default configuration of the three stages, made short and small."""
    cfg = {group: conf(group, "default") for group in ("avatar", "paint", "occlusion", "raster")}
    cfg["avatar"] |= {"subdivisions": 1}
    cfg["avatar"]["field"] |= {"table_log2": 8, "finest": 64}
    cfg["reconstruct"] = conf("reconstruct", "cpu") | {"steps": STEPS, "reskin_every": 4}
    return cfg


def outputs(folder: Path, *more: str) -> dict[str, Path]:
    """Paths of a stage's results."""
    names = {"avatar": "avatar.safetensors", "curves": "curves.json", "occlusion": "occlusion.json"}
    chosen = {name: folder / names[name] for name in ("avatar", *more)}
    return chosen | {"health": folder / "health.json", "evidence": folder / "evidence.jpg"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Path], dict[str, dict[str, Path]]]:
    """Inputs, and the outputs of each stage."""
    folder = tmp_path_factory.mktemp("making")
    inputs = toy.write_sequence(folder)
    crops = read_npz(folder / "crops" / "front.npz")
    normals = np.zeros_like(crops["rgb"], dtype=np.int8)
    normals[..., 2] = np.where(crops["alpha"] > 127, -127, 0)
    write_npz(folder / "normals" / "front.npz", {"front": normals, "back": -normals})
    inputs["normals"] = folder / "normals"
    cfg, job = options(), Job("toy", None, 0, 1, folder / "scratch")
    results = {
        "paint": outputs(folder / "paint"),
        "reconstruct": outputs(folder / "reconstruct", "curves"),
        "occlusion": outputs(folder / "occlusion", "occlusion"),
    }
    common = {k: inputs[k] for k in ("sequence", "body_model", "body", "crops")}
    paint.run(common, results["paint"], cfg, job)
    inputs = common | {"normals": inputs["normals"], "models": inputs["models"], "paint": results["paint"]["avatar"]}
    reconstruct.run(inputs, results["reconstruct"], cfg, job)
    occlusion.run(common | {"avatar": results["reconstruct"]["avatar"]}, results["occlusion"], cfg, job)
    return inputs, results


def test_every_stage_leaves_avatar_picture_and_health(made: tuple[dict, dict]) -> None:
    for stage, files in made[1].items():
        assert len(Avatar.read(files["avatar"])) == len(Avatar.read(made[1]["paint"]["avatar"]))
        picture = cv2.imread(str(files["evidence"]))
        assert picture is not None
        assert picture.std() > 5
        health = Health.read(files["health"])
        assert health.stage == stage
        assert all(v["value"] is not None for v in health.numbers.values())


def test_paint_sees_the_front(made: tuple[dict, dict]) -> None:
    health = Health.read(made[1]["paint"]["health"]).numbers
    assert 0.2 < health["seen"]["value"] < 0.6
    assert health["iou"]["value"] > 0.7


def test_curves_have_a_value_per_step(made: tuple[dict, dict]) -> None:
    curves = read_json(made[1]["reconstruct"]["curves"])
    assert {"l1", "ssim", "lpips", "mask"} <= set(curves)
    assert all(len(c) == STEPS and all(map(math.isfinite, c)) for c in curves.values())


def test_occlusion_numbers_are_those_of_the_avatar(made: tuple[dict, dict]) -> None:
    numbers = read_json(made[1]["occlusion"]["occlusion"])
    avatar = Avatar.read(made[1]["occlusion"]["avatar"])
    assert numbers["bor"] == pytest.approx(float(avatar.occlusion.mean()), abs=1e-5)
    assert 0.3 < numbers["bor_area"] < 0.7
    assert torch.equal(avatar.positions, Avatar.read(made[1]["reconstruct"]["avatar"]).positions)


def test_the_same_inputs_give_the_same_bytes(made: tuple[dict, dict], tmp_path: Path) -> None:
    again = outputs(tmp_path, "curves")
    reconstruct.run(made[0], again, options(), Job("toy", None, 0, 1, tmp_path / "scratch"))
    assert sha256_file(again["avatar"]) == sha256_file(made[1]["reconstruct"]["avatar"])


def test_normals_of_another_clip_are_named(made: tuple[dict, dict], tmp_path: Path) -> None:
    maps = read_npz(made[0]["normals"] / "front.npz")
    write_npz(tmp_path / "normals" / "front.npz", {k: v[:, :10] for k, v in maps.items()})
    with pytest.raises(ArtifactError, match="do not fit"):
        reconstruct.run(
            made[0] | {"normals": tmp_path / "normals"},
            outputs(tmp_path, "curves"),
            options(),
            Job("toy", None, 0, 1, tmp_path / "scratch"),
        )
