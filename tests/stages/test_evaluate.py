"""Figures of an avatar whose photographs are known."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import pytest
import torch

from soar.artifacts import read_json
from soar.health import Health
from soar.report.evaluation import METRICS
from soar.stages import Job, evaluate
from tests.report import toy


def run(folder: Path, inputs: dict[str, Path], **options) -> dict:
    """Run the stage on every frame and return metrics.json."""
    names = {"metrics": "metrics.json", "table": "per_frame.csv", "sheet": "comparison.jpg"}
    names |= {"health": "health.json", "evidence": "evidence.jpg"}
    outputs = {name: folder / "out" / file for name, file in names.items()}
    cfg = toy.cfg("evaluate", "raster")
    cfg["evaluate"] |= {"every": 2, **options}
    evaluate.run(inputs, outputs, cfg, Job("toy", None, 0, 1, folder / "scratch"))
    return read_json(outputs["metrics"])


@pytest.fixture(scope="module")
def perfect(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The avatar the photographs show."""
    folder = tmp_path_factory.mktemp("perfect")
    return folder, run(folder, toy.write_sequence(folder))


def test_a_perfect_avatar(perfect: tuple[Path, dict]) -> None:
    for camera in perfect[1]["cameras"].values():
        ours, paint = camera["methods"]["ours"], camera["methods"]["paint"]
        assert ours["iou"] == 1.0
        assert 40 < ours["psnr"] <= 100  # soft rims carry the photograph's background
        assert ours["lpips"] < 0.2 * paint["lpips"]
        assert ours["psnr"] > paint["psnr"] + 10
        assert ours["ssim"] > 0.99 > paint["ssim"]
        assert paint["iou"] == 1.0


def test_what_training_saw_is_visible_and_the_rest_occluded(perfect: tuple[Path, dict]) -> None:
    front, back = (perfect[1]["cameras"][name]["methods"]["ours"] for name in ("front", "back"))
    assert front["visible_mpsnr"] > 30  # rims carry the background
    assert front["occluded_mpsnr"] is None
    assert back["occluded_mpsnr"] > 30


def test_every_figure_has_its_protocol(perfect: tuple[Path, dict]) -> None:
    folder, metrics = perfect
    assert metrics["settings"]["background"] == "white"
    assert "alex" in metrics["settings"]["lpips"]
    assert "0.5" in metrics["settings"]["occluded"]
    assert metrics["cameras"]["front"]["crop"] == [64, 64]
    assert [c["split"] for c in metrics["cameras"].values()] == ["eval", "train"]
    assert metrics["cameras"]["back"]["frames"] == 2
    tau = toy.avatar().occlusion
    assert metrics["bor"]["surfels"] == pytest.approx(float(tau.mean()), abs=1e-6)
    with (folder / "out" / "per_frame.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * 2 * 3
    assert {row["frame"] for row in rows} == {"10", "12"}
    assert set(METRICS) < set(rows[0])
    mine = [float(r["psnr"]) for r in rows if r["camera"] == "back" and r["method"] == "ours"]
    assert sum(mine) / 2 == pytest.approx(metrics["cameras"]["back"]["methods"]["ours"]["psnr"])


def test_pictures_and_health(perfect: tuple[Path, dict]) -> None:
    folder = perfect[0] / "out"
    assert cv2.imread(str(folder / "comparison.jpg")).shape[0] > 2 * 360
    assert cv2.imread(str(folder / "evidence.jpg")) is not None
    numbers = Health.read(folder / "health.json").numbers
    assert numbers["train_iou/front"]["value"] == 1.0
    assert numbers["eval_psnr_gain/back"]["value"] > 10
    assert 0 < numbers["bor_area"]["value"] < 1


def test_a_shifted_avatar_scores_less(perfect: tuple[Path, dict], tmp_path: Path) -> None:
    truth = toy.avatar()
    shifted = truth.replace(positions=truth.positions + torch.tensor([0.04, 0.0, 0.0]))
    worse = run(tmp_path, toy.write_sequence(tmp_path, shifted))["cameras"]["front"]["methods"]["ours"]
    good = perfect[1]["cameras"]["front"]["methods"]["ours"]
    assert 0.7 < worse["iou"] < 0.95
    assert worse["psnr"] < good["psnr"] - 10
    assert worse["ssim"] < good["ssim"]
    assert worse["lpips"] > good["lpips"]
    assert worse["visible_mpsnr"] < good["visible_mpsnr"] - 5


def test_calibration_undoes_another_white_balance(tmp_path: Path) -> None:
    truth = toy.avatar()
    tinted = truth.replace(colours=truth.colours * torch.tensor([0.6, 0.7, 0.8]) + 0.1)
    ours = run(tmp_path, toy.write_sequence(tmp_path, tinted))["cameras"]["front"]
    figures = ours["methods"]["ours"]
    assert figures["visible_mpsnr_calibrated"] > figures["visible_mpsnr"] + 10
    assert figures["psnr_calibrated"] > figures["psnr"] + 5
    assert ours["colour"]["ours"]["gain"] == pytest.approx([1 / 0.6, 1 / 0.7, 1 / 0.8], rel=0.1)


def test_small_regions_are_not_measured(tmp_path: Path) -> None:
    metrics = run(tmp_path, toy.write_sequence(tmp_path), min_pixels=64 * 64 + 1)
    for camera in metrics["cameras"].values():
        assert camera["methods"]["ours"]["visible_mpsnr"] is None
        assert camera["methods"]["ours"]["psnr"] > 40
