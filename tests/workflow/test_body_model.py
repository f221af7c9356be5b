"""The body that a user brings: who refuses it, which record a variant works with, and the DAG that makes it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from soar.cli import main
from soar.errors import ConfigError
from soar.workflow import STAGES, Workflow
from tests.conftest import ROOT

DEFAULT = "data/models/body/anny.npz"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file that is there; what is in it does not matter while the DAG is built."""
    path = tmp_path / "SMPLX NEUTRAL.npz"
    path.write_bytes(b"")
    return path


def brought(file: Path, *more: str, **groups: str) -> Workflow:
    return Workflow({"body_model": "smplx", **groups, "overrides": [f"body_model.source='{file}'", *more]})


def record(flow: Workflow, stage: str = "body", variant: str = "full") -> str | list[str]:
    return flow.inputs(stage, flow.sequences[0], variant)["body_model"]


def test_the_default_body_needs_no_file() -> None:
    flow = Workflow({})
    assert flow.body_model_jobs() == {}
    assert {record(flow, stage) for stage in STAGES if "body_model" in STAGES[stage].reads and stage != "truth"} == {
        DEFAULT
    }
    with pytest.raises(ConfigError, match="comes with the other model files"):
        flow.body_model_job("full")


def test_every_stage_works_with_the_record_of_the_file(file: Path) -> None:
    flow = brought(file)
    (made,) = flow.body_model_jobs()
    path = f"data/models/body/{made}.npz"
    assert {record(flow, stage) for stage in STAGES if "body_model" in STAGES[stage].reads and stage != "truth"} == {
        path
    }
    cfg, files = flow.body_model_jobs()[made]
    assert cfg["body_model"]["source"] == files["inputs"]["source"] == str(file)
    assert files["outputs"]["body_model"] == path


def test_another_file_or_parameter_is_another_record(file: Path) -> None:
    other = file.with_name("SMPLX_MALE.npz")
    other.write_bytes(b"")
    flows = [brought(file), brought(other), brought(file, "body_model.num_betas=16"), brought(file)]
    records = [str(record(flow)) for flow in flows]
    assert len(set(records)) == 3
    assert records[0] == records[3]
    # What depends on it is not what depends on the default body.
    assert flows[0]._lineage("render", "full") != Workflow({})._lineage("render", "full")
    assert flows[0]._lineage("frames", "full") == Workflow({})._lineage("frames", "full")


def test_refusals(file: Path) -> None:
    for flow, message in (
        (lambda: Workflow({"body_model": "smplx"}), r"needs the model file(.|\n)*got: +nothing"),
        (lambda: brought(file.with_name("none.npz")), r"none\.npz, which is not there"),
        (lambda: brought(file.parent), "which is not there"),
        (lambda: brought(file, dataset="synthetic"), r"dataset synthetic are known as bodies of the default"),
        (lambda: Workflow({"overrides": ["body_model.provider=star"]}), r"expected: anny, smplx(.|\n)*got: +star"),
        (lambda: Workflow({"body_model": "star"}), "star"),
    ):
        with pytest.raises(ConfigError, match=message) as caught:
            flow()
        assert caught.value.cure


def test_by_hand_a_file_that_is_no_model_is_named(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["body_model", "body_model=smplx", f"body_model.source='{file.name}'"]) == 2
    message = capsys.readouterr().err
    assert "ModelFileError" in message
    assert "SMPLX NEUTRAL.npz cannot be read" in message
    assert not list(tmp_path.glob("data/models/body/*.npz"))


def test_the_dag_resolves(file: Path, tmp_path: Path) -> None:
    """The real Snakefile on footage of two cameras; nothing runs."""
    for name in ("Snakefile", "workflow", "profiles", "conf", "soar"):
        (tmp_path / name).symlink_to(ROOT / name)
    cameras = {}
    for index, name in enumerate(("left", "right")):
        (tmp_path / "capture" / name).mkdir(parents=True)
        (tmp_path / "capture" / name / "000.png").write_bytes(b"not looked at while the DAG is built")
        T = np.eye(4)
        T[0, 3] = index
        cameras[name] = {"size": [64, 48], "K": [60, 60, 32, 24], "T_cam_from_world": T.tolist()}
    (tmp_path / "capture" / "calibration.json").write_text(json.dumps({"cameras": cameras}))
    overrides = ["dataset.path=capture", "dataset.train=[left]", "dataset.eval=[right]"]
    overrides.append(f"body_model.source='{file.name}'")
    options = ["dataset=cameras", "body_model=smplx", f"overrides={json.dumps(overrides)}"]
    command = [sys.executable, "-m", "snakemake", "-s", "Snakefile", "-n", "-p", "--cores", "2", "--config", *options]
    plan = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    output = plan.stdout + plan.stderr
    assert plan.returncode == 0, output
    counts = dict(re.findall(r"^(\w+) +(\d+)$", output, re.M))
    assert counts["body_model"] == "1"
    assert {"models", "body", "reconstruct", "refine", "evaluate", "report"} <= counts.keys()
    (command,) = re.findall(r"-m soar body_model .*", output)
    assert '"source":"SMPLX NEUTRAL.npz"' in command
    made = re.findall(r'"body_model":"(data/models/body/smplx-\w+\.npz)"', command)[0]
    (command,) = re.findall(r"-m soar body .*", output)
    assert f'"body_model":"{made}"' in command
