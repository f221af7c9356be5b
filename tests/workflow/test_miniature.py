"""The whole DAG on a few frames of real footage, as a user with one clip runs it; skipped where nothing is fetched."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from soar.artifacts import read_tensors
from tests.conftest import ROOT, model_file

CLIP = ROOT / "data" / "datasets" / "demo" / "cam02.mp4"
SMALL = (
    "dataset.path=my clip.mp4",
    "dataset.frames.stride=12",
    "dataset.frames.min_frames=4",
    "crops.long_side=320",
    "reconstruct.steps=4",
    "refine.shape.steps=2",
    "refine.texture.steps=2",
    "render.turntable.frames=4",
)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project, in a folder with a space in its name, that shares the fetched models."""
    model_file("manifest.json")
    if not CLIP.exists():
        pytest.skip("the demo footage is not there; `make demo` brings it")
    folder = tmp_path_factory.mktemp("mini") / "a project"
    folder.mkdir()
    shutil.copy(ROOT / "Snakefile", folder)
    for name in ("workflow", "profiles", "conf", "soar"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "data").mkdir()
    (folder / "data" / "models").symlink_to(ROOT / "data" / "models")
    (folder / "my clip.mp4").symlink_to(CLIP)
    return folder


def snakemake(folder: Path, *arguments: str, overrides: tuple[str, ...] = SMALL) -> subprocess.CompletedProcess[str]:
    """The real command line on the user's own clip."""
    options = ["dataset=video", "overrides=" + json.dumps(list(overrides))]
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments, "--config", *options]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_one_clip_becomes_an_avatar_and_a_report(project: Path) -> None:
    result = snakemake(project)
    assert result.returncode == 0, result.stdout + result.stderr
    folder = next((project / "results" / "video").glob("*/full"))
    tensors, _ = read_tensors(folder / "occlusion" / "avatar.safetensors")
    assert len(tensors["positions"]) > 40_000
    ratio = json.loads((folder / "occlusion" / "occlusion.json").read_text())["bor"]
    assert 0.1 < ratio < 0.6  # a clip that shows the front only
    overlap = json.loads((folder / "body" / "health.json").read_text())["numbers"]["overlap"]["value"]
    assert overlap > 0.75
    assert not (folder / "monocular").exists()  # there is nothing to check a single camera against
    page = (project / "results" / "video" / "report" / "report.html").read_text()
    assert "assumed" in page  # the field of view nobody gave is said to be a guess
    assert not list(project.glob("results/**/.*.scratch"))


def test_nothing_is_done_twice(project: Path) -> None:
    result = snakemake(project)
    assert "Nothing to be done" in result.stdout + result.stderr


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("dataset.path=absent.mp4",), "absent.mp4"),
        (("dataset.path=broken.mp4",), "broken.mp4"),
        (("dataset.path=my clip.mp4", "dataset.frames.max_frames=1"), "too few"),
    ],
)
def test_unusable_clips_are_named(project: Path, overrides: tuple[str, ...], message: str) -> None:
    (project / "broken.mp4").write_bytes(CLIP.read_bytes()[:20_000])
    result = snakemake(project, overrides=overrides)
    output = result.stdout + result.stderr
    assert result.returncode != 0
    assert message in output
    assert "Traceback" not in output
