"""The preset ``paper``: it composes, its avatar learns, its body fit converges; on other tests' miniatures."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from soar.artifacts import read_json, read_npz, write_npz
from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar
from soar.body import measure
from soar.body.fit import FitSettings
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.optimise.reconstruct import ReconstructSettings
from soar.optimise.refine import RefineSettings
from soar.optimise.views import Views
from soar.raster import RasterSettings
from soar.stages import Job, body, calibrate, paint, reconstruct
from soar.workflow import STAGES, Workflow, composed
from tests.body import stickman
from tests.body.test_stages import FRAMES, recording, run
from tests.conftest import ROOT, conf, model_file
from tests.report import toy

__all__ = ["recording"]  # a fixture

PAPER = composed(("preset=paper",))
SCHEMAS = {
    "avatar": AvatarSettings,
    "reconstruct": ReconstructSettings,
    "refine": RefineSettings,
    "body": FitSettings,
    "raster": RasterSettings,
}


@pytest.mark.parametrize("group", SCHEMAS)
def test_the_groups_are_the_papers_and_fit_their_schemas(group: str) -> None:
    option = "paper" if (ROOT / "conf" / group / "paper.yaml").exists() else "default"
    assert PAPER[group] == conf(group, option)
    settings(SCHEMAS[group], PAPER[group], group)
    if option == "paper":
        assert PAPER[group] != composed(())[group]


def test_numbers_printed_in_the_paper() -> None:
    assert (PAPER["reconstruct"]["steps"], PAPER["avatar"]["neighbours"], PAPER["avatar"]["attributes"]) == (
        500,
        30,
        "field",
    )
    weights = PAPER["reconstruct"]["weights"]
    assert [weights[name] for name in ("l1", "ssim", "lpips", "mask", "normal_cosine")] == [0.2, 0.8, 1.0, 1.0, 0.2]
    phases = [PAPER["refine"][phase] for phase in ("shape", "texture")]
    assert [(phase["steps"], phase["weights"]["sds"]) for phase in phases] == [(500, 1e-4), (1000, 1e-4)]
    assert [PAPER["body"]["weights"][name] for name in ("data", "smooth", "preserve")] == [100, 10_000, 60]


def test_it_can_be_combined_and_leaves_perception_alone() -> None:
    filtered = composed(("preset=paper", "raster=surfels_reference", "reconstruct.steps=7"))
    assert filtered["raster"] == conf("raster", "surfels_reference")
    assert filtered["reconstruct"] == conf("reconstruct", "paper") | {"steps": 7}
    ours, papers = Workflow({}), Workflow({"preset": "paper"})
    same = {stage for stage in STAGES if ours.slice(stage, "full") == papers.slice(stage, "full")}
    assert {"ingest", "frames", "keypoints", "masks", "calibrate", "crops", "normals"} <= same
    assert not {"body", "paint", "reconstruct", "refine"} & same


def files(folder: Path, *more: str) -> dict[str, Path]:
    """Paths of an avatar stage's results."""
    names = {"avatar": "avatar.safetensors", "curves": "curves.json"}
    chosen = {name: folder / names[name] for name in ("avatar", *more)}
    return chosen | {"health": folder / "health.json", "evidence": folder / "evidence.jpg"}


def test_a_few_steps_lower_colour_and_mask_losses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The photographed capsule is 1.5 cm fatter than the body the avatar starts from, and not grey."""
    thin = toy.avatar()
    monkeypatch.setattr(toy, "avatar", lambda: thin.replace(positions=thin.positions + 0.015 * thin.normals))
    small = ["avatar.subdivisions=1", "avatar.field.table_log2=12", "avatar.field.prefit_steps=40"]
    cfg = composed(("preset=paper", "reconstruct.steps=28", *small))
    inputs = toy.write_sequence(tmp_path)
    inputs["models"] = model_file("lpips_vgg.safetensors").parent
    crops = read_npz(tmp_path / "crops" / "front.npz")
    facing = np.zeros_like(crops["rgb"], dtype=np.int8)
    facing[..., 2] = np.where(crops["alpha"] > 127, -127, 0)
    inputs["normals"] = tmp_path / "normals"
    write_npz(inputs["normals"] / "front.npz", {"front": facing, "back": -facing})
    job, painted, made = Job("toy", None, 0, 1, tmp_path / "scratch"), files(tmp_path / "p"), files(tmp_path, "curves")
    paint.run(inputs, painted, cfg, job)
    inputs["paint"] = painted["avatar"]
    reconstruct.run(inputs, made, cfg, job)

    curves = read_json(made["curves"])
    assert {"l1", "ssim", "lpips", "mask", "normal_cosine", "normal_lpips", "curvature", "scale_mean"} <= set(curves)
    for name in ("l1", "ssim", "lpips", "mask"):
        assert np.mean(curves[name][-4:]) < 0.95 * np.mean(curves[name][:4]), name  # four crops, each once
    avatar = Avatar.read(painted["avatar"])
    start = avatar.replace(colours=torch.full_like(avatar.colours, 0.5))
    before, after = (errors(a, inputs, cfg, crops) for a in (start, Avatar.read(made["avatar"])))
    assert after[0] < 0.85 * before[0]
    assert after[1] < 0.9 * before[1]


def errors(avatar: Avatar, inputs: dict[str, Path], cfg: dict[str, Any], crops: dict[str, np.ndarray]) -> np.ndarray:
    """Mean absolute error of the colour inside the mask, and of alpha, over all crops."""
    articulation = Articulation.of(BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"]))
    puppet = Puppet(avatar, articulation, settings(RasterSettings, cfg["raster"], "raster"))
    views = Views.of("front", crops)
    found = []
    for i in range(len(views)):
        render = puppet.render(int(views.frames[i]), views.T_cam_from_world, views.pinhole(i))
        mask = views.mask(i)
        colour = ((render.colour - views.image(i)).abs() * mask).sum() / mask.sum()
        found.append([float(colour), float((render.alpha - mask).abs().mean())])
    return np.mean(found, axis=0)


def test_the_body_fit_converges_near_the_truth(recording: dict[str, Path], tmp_path: Path) -> None:
    """As many epochs again change nothing, and smoothness has not pulled the body away from what was seen."""
    inputs = recording | {"calibration": tmp_path / "calibration.json"}
    nearby = PAPER["calibrate"] | {"min_points": 20}
    run(calibrate, inputs, tmp_path, {"calibration": inputs["calibration"]}, calibrate=nearby)
    totals = []
    for epochs in (PAPER["body"]["epochs"] // 2, PAPER["body"]["epochs"]):
        product = {"body": tmp_path / "body.npz", "cameras": tmp_path / "cameras.json"}
        node = PAPER["body"] | {"epochs": epochs}
        numbers = run(body, inputs, tmp_path, product, body=node, monocular=PAPER["monocular"])
        terms = {name: value for name, value in numbers.items() if name.startswith("term_")}
        assert set(terms) == {"term_data", "term_smooth", "term_preserve"}
        totals.append(sum(terms.values()))
    assert totals[1] == pytest.approx(totals[0], rel=1e-4)
    assert numbers["reprojection_limbs"] < 5
    model, found = stickman.body(), BodyMotion.read(product["body"])
    exact = dataclasses.replace(found, **{f.name: getattr(found, f.name).double() for f in dataclasses.fields(found)})
    valid = model.keypoint_valid.numpy()
    points, truth = (measure.motion_keypoints(model, m)[:, valid] for m in (exact, stickman.motion(model, FRAMES)))
    assert 100 * np.median(np.linalg.norm(points - truth, axis=-1)) < 2.5
