"""Which code and which data files of the package count for which stage."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from soar.workflow import Workflow, fingerprint
from tests.conftest import ROOT

READERS = {
    "soar/body/data/anny_face68.json": {"models"},
    "soar/networks/data/normals.onnx": {"normals"},
    "soar/networks/data/prior.onnx": {"refine"},
    "soar/networks/data/records/normals.onnx.json": {"normals"},
    "soar/networks/data/records/prior.onnx.json": {"refine"},
    "soar/report/page.html": {"report"},
}
"""Data file -> the stages that read it."""

FINGERPRINTS = """
import json
from soar.workflow import SETUP, STAGES, fingerprint
print(json.dumps({name: fingerprint(name, {}) for name in (*SETUP, *STAGES, "report")}))
"""


def fingerprints(folder: Path) -> dict[str, str]:
    """Of all stages, as the package in ``folder`` has them."""
    command = [sys.executable, "-c", FINGERPRINTS]
    return json.loads(subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package."""
    folder = tmp_path_factory.mktemp("fingerprints")
    shutil.copytree(ROOT / "soar", folder / "soar", ignore=shutil.ignore_patterns("__pycache__", "*.so", "_build"))
    return folder


@pytest.fixture(scope="module")
def untouched(project: Path) -> dict[str, str]:
    """Fingerprints of the copy as it is."""
    return fingerprints(project)


def test_every_data_file_is_listed_with_its_readers(project: Path) -> None:
    code = {".py", ".cpp", ".h"}
    files = {path for path in (project / "soar").rglob("*") if path.is_file() and path.suffix not in code}
    assert {path.relative_to(project).as_posix() for path in files if "__pycache__" not in path.parts} == set(READERS)


@pytest.mark.parametrize(("name", "readers"), READERS.items())
def test_a_data_file_counts_for_its_readers_alone(
    project: Path, untouched: dict[str, str], name: str, readers: set[str]
) -> None:
    path = project / name
    content = path.read_bytes()
    try:
        path.write_bytes(content + b" ")
        changed = fingerprints(project)
    finally:
        path.write_bytes(content)
    assert {stage for stage in untouched if changed[stage] != untouched[stage]} == readers


def test_the_adapter_in_use_is_code_of_the_stages_that_read_footage() -> None:
    made, demo = (Workflow({"dataset": name}) for name in ("synthetic", "demo"))
    assert fingerprint("frames", made.slice("frames", "full")) != fingerprint("frames", demo.slice("frames", "full"))
    assert fingerprint("crops", made.slice("crops", "full")) == fingerprint("crops", demo.slice("crops", "full"))
