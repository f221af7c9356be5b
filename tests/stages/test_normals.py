"""The normals stage on the toy sequence: files, health, and a body that is not where the mask is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from soar.artifacts import read_json, read_npz, write_json, write_npz
from soar.body.motion import BodyMotion
from soar.health import Health
from soar.stages import Job, normals
from tests.conftest import conf
from tests.report import toy

SCALE, RECT = 0.5, (5, 3, 64, 64)
"""Working resolution, and the toy's crops in whole frames at it, which are 80 x 70."""


def write_sequence(folder: Path) -> None:
    """The toy sequence, its crops being windows of larger frames."""
    toy.write_sequence(folder)
    record = read_json(folder / "sequence.json")
    for camera in record["cameras"]:
        camera["width"], camera["height"] = 160, 140
        path = folder / "crops" / f"{camera['name']}.npz"
        crops = read_npz(path)
        write_npz(path, crops | {"scale": np.float64(SCALE), "rect": np.tile(np.int32(RECT), (len(crops["rgb"]), 1))})
    write_json(folder / "sequence.json", record)


def run(
    folder: Path, camera: str, node: dict | None = None, brought: dict[str, Path] | None = None
) -> tuple[dict[str, np.ndarray], Health]:
    """The stage with the configuration ``node``, body normals by default."""
    inputs = (brought or {}) | {
        "sequence": folder / "sequence.json",
        "body_model": folder / "body_model.npz",
        "body": folder / "body.npz",
        "crops": folder / "crops" / f"{camera}.npz",
    }
    outputs = {n: folder / "out" / f for n, f in (("normals", "n.npz"), ("health", "h.json"), ("evidence", "e.jpg"))}
    cfg = {"normals": node or conf("normals", "body"), "raster": conf("raster", "default")}
    normals.run(inputs, outputs, cfg, Job("toy", camera, 0, 1, folder / "scratch"))
    assert outputs["evidence"].stat().st_size > 1000
    return read_npz(outputs["normals"]), Health.read(outputs["health"])


@pytest.mark.parametrize("camera", ["front", "back"])
def test_maps_of_every_crop(tmp_path: Path, camera: str) -> None:
    write_sequence(tmp_path)
    maps, health = run(tmp_path, camera)
    crops = read_npz(tmp_path / "crops" / f"{camera}.npz")
    for side, sign in (("front", -1), ("back", 1)):
        assert maps[side].dtype == np.int8
        assert maps[side].shape == crops["rgb"].shape
        surface = np.abs(maps[side].astype(int)).max(-1) > 0
        lengths = np.linalg.norm(maps[side][surface] / 127.0, axis=-1)
        assert abs(lengths - 1).max() < 0.02
        assert (sign * maps[side][surface][:, 2] > 0).mean() > 0.95
    assert health.numbers["coverage_iou"]["value"] > 0.85
    assert health.numbers["sign_test_failed"]["value"] == 0
    assert not health.remarks


def test_a_body_out_of_view_is_reported(tmp_path: Path) -> None:
    write_sequence(tmp_path)
    motion = BodyMotion.read(tmp_path / "body.npz")
    moved = motion.translation + torch.tensor([50.0, 0.0, 50.0])
    BodyMotion(motion.betas, motion.pose, moved, motion.keypoint_offsets).write(tmp_path / "body.npz")
    maps, health = run(tmp_path, "front")
    assert not maps["front"].any()
    assert health.numbers["coverage_iou"]["value"] == 0
    assert health.numbers["sign_test_failed"]["value"] == 1
    assert "sign test" in health.remarks[0]
