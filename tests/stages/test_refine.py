"""The refine stage as the workflow runs it, on the toy sequence and with the bundled prior."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from soar.artifacts import read_json, read_npz, sha256_file, write_json, write_npz
from soar.avatar.surfels import Avatar
from soar.cli import execute
from soar.errors import ModelFileError
from soar.health import Health
from soar.metrics.colour import saturation
from soar.priors.mini import MiniProvider
from soar.workflow import STAGES, composed, output_paths
from tests.report import toy

SMALL = (
    "avatar.attributes=explicit",
    "reconstruct.weights.lpips=0",
    "reconstruct.weights.normal_lpips=0",
    "refine.shape.steps=2",
    "refine.shape.rates={positions:1e-3,normals:1e-2,colours:0.0,scales:0.0,field:0.0}",
    "refine.shape.reskin_every=1",
    "refine.shape.checkpoint_seconds=0",
    "refine.texture.steps=4",
    "refine.texture.rates={positions:0.0,normals:0.0,colours:2e-2,scales:0.0,field:0.0}",
    "refine.texture.reskin_every=1",
    "refine.texture.checkpoint_seconds=0",
)
MINI = ("prior=mini", "prior.guidance=1")  # one sample instead of two


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The toy sequence; the avatar's rear half was never seen and is grey."""
    folder = tmp_path_factory.mktemp("refine")
    truth = toy.avatar()
    unseen = truth.occlusion[:, None] > 0.5
    files = toy.write_sequence(folder, truth.replace(colours=torch.where(unseen, 0.5, truth.colours)))
    crops = read_npz(folder / "crops" / "front.npz")
    facing = np.zeros_like(crops["rgb"], np.int8)
    facing[..., 2] = np.where(crops["alpha"] > 127, -127, 0)
    write_npz(folder / "normals" / "front.npz", {"front": facing, "back": -facing})
    write_json(folder / "caption.json", {"text": "A capsule.", "provider": "text", "evidence": {}})
    write_json(folder / "models" / "manifest.json", {})
    files |= {"normals": folder / "normals", "caption": folder / "caption.json"}
    return {name: files[name] for name in STAGES["refine"].reads}


def run(inputs: dict[str, Path], folder: Path, *overrides: str) -> dict[str, Path]:
    outputs = {name: Path(path) for name, path in output_paths(STAGES["refine"], str(folder), None).items()}
    whole = composed((*SMALL, *overrides))
    cfg = {"seed": 0} | {node: whole[node] for node in STAGES["refine"].config}
    execute("refine", inputs, outputs, cfg, sequence="toy", camera=None, threads=1)
    return outputs


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.fixture(scope="module")
def finished(inputs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What an undisturbed run leaves."""
    return run(inputs, tmp_path_factory.mktemp("finished"), *MINI)


def test_avatar_curves_sheet_and_health(inputs: dict[str, Path], finished: dict[str, Path]) -> None:
    outputs = finished
    assert sorted(files(outputs["avatar"].parent)) == sorted(outputs.values())
    start, avatar = Avatar.read(inputs["avatar"]), Avatar.read(outputs["avatar"])
    assert len(avatar) == len(start)
    assert torch.equal(avatar.occlusion, start.occlusion)
    assert not torch.equal(avatar.positions, start.positions)
    unseen = start.occlusion > 0.5
    assert float((avatar.colours - start.colours)[unseen].abs().mean()) > 1e-3

    curves = read_json(outputs["curves"])
    for phase, steps in (("shape", 2), ("texture", 4)):
        for term in ("sds", "l1", "mask"):
            assert len(curves[f"{phase}/{term}"]) == steps
            assert np.isfinite(curves[f"{phase}/{term}"]).all()
    assert "shape/views_normal_depth" in curves
    assert "texture/views_normal_depth" not in curves

    numbers = {name: entry["value"] for name, entry in Health.read(outputs["health"]).numbers.items()}
    colours = avatar.colours.numpy()
    hidden, shown = saturation(colours[unseen]), saturation(colours[~unseen])
    assert numbers["saturation_gap"] == pytest.approx(abs(hidden - shown) / shown, rel=1e-4)
    changed = (avatar.colours - start.colours).abs().mean(1)
    assert numbers["colour_change_unseen"] == pytest.approx(float(changed[unseen].mean()), rel=1e-4)
    assert numbers["colour_change_seen"] == pytest.approx(float(changed[~unseen].mean()), rel=1e-4)
    assert numbers["iou"] > 0.9
    assert abs(numbers["iou_gain"]) < 0.1
    assert numbers["white_crop_psnr"] > 20
    assert numbers["texture/sds/last"] == pytest.approx(curves["texture/sds"][-1])
    assert all(value is not None for value in numbers.values())
    sheet = cv2.imread(str(outputs["evidence"]))
    assert sheet.shape[0] > 1200
    assert sheet.std() > 20


def test_missing_weights_are_named_and_nothing_is_written(inputs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"absent\.pt is missing") as caught:
        run(inputs, tmp_path, "prior=imagedream", "prior.source=absent.pt", "prior.device=cpu")
    assert "docs/priors.md" in str(caught.value)
    assert not files(tmp_path)


def test_without_distillation_no_prior_is_needed(inputs: dict[str, Path], tmp_path: Path) -> None:
    given = "prior=imagedream", "prior.source=absent.pt", "variant=no_sds"
    outputs = run(inputs, tmp_path, *given)
    curves = read_json(outputs["curves"])
    assert len(curves["shape/l1"]) == 2
    assert len(curves["texture/l1"]) == 4
    assert not [name for name in curves if "sds" in name or "views" in name]


def test_a_stage_that_was_killed_goes_on_and_ends_with_the_same_bytes(
    inputs: dict[str, Path], finished: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loss, asked = MiniProvider.loss, []

    def dying(self: MiniProvider, *arguments: Any) -> torch.Tensor:
        asked.append(1)
        if len(asked) == 5:
            raise KeyboardInterrupt
        return loss(self, *arguments)

    monkeypatch.setattr(MiniProvider, "loss", dying)
    with pytest.raises(KeyboardInterrupt):
        run(inputs, tmp_path, *MINI)
    left = files(tmp_path)
    assert {path.name for path in left} == {"shape.pt", "texture.pt"}
    assert all(".scratch" in str(path) for path in left)
    asked[:] = [1] * 10
    again = run(inputs, tmp_path, *MINI)
    assert len(asked) == 10 + 2  # the last two of 2 + 4 steps
    for name in ("avatar", "curves", "health"):
        assert sha256_file(finished[name]) == sha256_file(again[name]), name
    assert sorted(files(tmp_path)) == sorted(again.values())


def test_what_is_distilled_decides_what_a_prompt_shows(
    inputs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every crop once per phase, normals for the shape and colours for the texture, with the caption's words."""
    seen = []

    def prepare(self: MiniProvider, conditions: list) -> list:
        seen.extend(conditions)
        raise KeyboardInterrupt

    monkeypatch.setattr(MiniProvider, "prepare", prepare)
    with pytest.raises(KeyboardInterrupt):
        run(inputs, tmp_path, *MINI)
    assert [condition.domain for condition in seen] == ["normal", "colour"] * toy.FRAMES
    assert {condition.text for condition in seen} == {"A capsule."}
    assert all(condition.picture.shape == (3, 64, 64) for condition in seen)
    seen.clear()
    with pytest.raises(KeyboardInterrupt):
        run(inputs, tmp_path, *MINI, "refine.shape.steps=0")
    assert [condition.domain for condition in seen] == ["colour"] * toy.FRAMES
