"""What re-runs and what does not, on a copy of the workflow whose stages only write small files.

The Snakefile, rules, profile, configuration and command line are the real ones; only ``soar/stages`` is replaced, so
that a whole DAG of two cameras takes seconds.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from soar.workflow import SETUP, STAGES

ROOT = Path(__file__).resolve().parents[2]

STAGE = '''
"""A stage that writes what it was asked for."""
import time
from pathlib import Path

def run(inputs, outputs, cfg, job):
    """Fail when an input is missing; write every output."""
    for path in inputs.values():
        assert path.exists(), path
    if Path("slow").exists() and "{stage}" == "reconstruct":
        Path("running").write_text("{stage}")
        time.sleep(60)
    for name, path in outputs.items():
        if name == "models":
            (path / "body").mkdir(parents=True, exist_ok=True)
            (path / "manifest.json").write_text("{{}}")
            (path / "body" / "anny.npz").write_text("body")
            (path / "body" / "anny_helpers.npz").write_text("helpers")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("{stage} " + str(sorted(cfg)) + str(cfg))
'''


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run in a folder with a space in its name."""
    folder = tmp_path_factory.mktemp("dag") / "a project"
    folder.mkdir()
    for name in ("Snakefile", "workflow", "profiles", "conf", "soar"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so", "_build"))
        else:
            shutil.copy(source, folder / name)
    for name in (*SETUP, *STAGES, "report"):
        (folder / "soar" / "stages" / f"{name}.py").write_text(STAGE.format(stage=name))
    capture = folder / "capture"
    cameras = {}
    for index, name in enumerate(("left", "right")):
        (capture / name).mkdir(parents=True)
        for frame in range(3):
            (capture / name / f"{frame:03d}.png").write_bytes(b"not looked at while the DAG is built")
        T = np.eye(4)
        T[0, 3] = index
        cameras[name] = {"size": [64, 48], "K": [60, 60, 32, 24], "T_cam_from_world": T.tolist()}
    (capture / "calibration.json").write_text(json.dumps({"cameras": cameras}))
    result = snakemake(folder)
    assert result.returncode == 0, result.stdout + result.stderr
    return folder


OPTIONS = ["dataset=cameras", 'overrides=["dataset.path=capture","dataset.train=[left]","dataset.eval=[right]"]']


def snakemake(folder: Path, *arguments: str, config: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    """Run the real command line in ``folder``."""
    command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments, "--config", *OPTIONS, *config]
    return subprocess.run(command, cwd=folder, env=_environment(folder), capture_output=True, text=True, check=False)


def _environment(folder: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(folder)}


def planned(result: subprocess.CompletedProcess[str]) -> set[str]:
    """Names of the rules a dry run would run."""
    assert result.returncode == 0, result.stdout + result.stderr
    return counts(result).keys() - {"all", "total"}


def counts(result: subprocess.CompletedProcess[str]) -> dict[str, int]:
    """Jobs per rule in the table of a run."""
    table = re.findall(r"^(\w+) +(\d+)$", result.stdout + result.stderr, re.M)
    return {rule: int(count) for rule, count in table}


def test_second_run_does_nothing(finished: Path) -> None:
    result = snakemake(finished)
    assert result.returncode == 0
    assert "Nothing to be done" in result.stdout + result.stderr


def test_every_artifact_has_a_provenance_record(finished: Path) -> None:
    record = json.loads(next(finished.glob("results/*/*/full/body/provenance.json")).read_text())
    assert record["stage"] == "body"
    assert record["inputs"].keys() >= {"calibration", "keypoints/left.npz", "keypoints/right.npz", "masks/left.zip"}
    assert record["code"]["fingerprint"]


def test_a_reconstruct_value_reruns_reconstruct_and_below(finished: Path) -> None:
    rules = planned(snakemake(finished, "-n", config=("reconstruct={steps: 7}",)))
    assert rules == {"reconstruct", "occlusion", "refine", "render", "views", "evaluate", "report"}


def test_a_comment_reruns_nothing_and_code_reruns_its_stage(finished: Path) -> None:
    module = finished / "soar" / "stages" / "crops.py"
    text = module.read_text()
    try:
        module.write_text(text.replace("def run", "# a comment\n\n\ndef run").replace("A stage", "A small stage"))
        assert planned(snakemake(finished, "-n")) == set()
        module.write_text(text.replace('" + str(sorted(cfg))', '!" + str(sorted(cfg))'))
        rules = planned(snakemake(finished, "-n"))
        assert {"crops", "normals", "reconstruct", "report"} <= rules
        assert not rules & {"ingest", "frames", "keypoints", "masks", "calibrate", "body"}
    finally:
        module.write_text(text)


def test_deleted_masks_of_one_camera_are_remade_with_what_depends_on_them(finished: Path) -> None:
    mask = next(finished.glob("results/*/*/full/masks/left.zip"))
    content = mask.read_bytes()
    mask.unlink()
    try:
        result = snakemake(finished, "-n")
        rules = planned(result)
        assert {"masks", "body", "monocular", "crops", "reconstruct", "report"} <= rules
        assert not rules & {"ingest", "frames", "keypoints", "calibrate"}
        assert counts(result)["masks"] == 1
    finally:
        mask.write_bytes(content)


def test_variants_share_what_is_equal(finished: Path) -> None:
    result = snakemake(finished, "-n", config=("variants=[full,no_implicit]",))
    assert planned(result) >= {"reconstruct", "occlusion", "evaluate"}
    assert not planned(result) & {"ingest", "frames", "keypoints", "masks", "calibrate", "body", "crops", "normals"}
    assert counts(result)["reconstruct"] == 1


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (("reconstruct={no_such_key: 1}",), "no_such_key"),
        (("variants=[full,nonsense]",), "nonsense"),
        (("body=nonsense",), "nonsense"),
        (("sequences=[nobody]",), "nobody"),
        (("masks=dataset",), "the dataset cameras gives no masks"),
    ],
)
def test_unknown_names_are_named(finished: Path, config: tuple[str, ...], message: str) -> None:
    result = snakemake(finished, "-n", config=config)
    assert result.returncode != 0
    assert message in result.stdout + result.stderr
    assert "Traceback" not in result.stdout + result.stderr


def test_a_dataset_that_knows_its_people_gives_them_to_the_stages(finished: Path) -> None:
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "-n", "-p", "--config", "dataset=synthetic"]
    options = ["sequences=[benchmark-0000-walk]", "keypoints=mediapipe"]
    plan = subprocess.run(
        [*command, *options], cwd=finished, env=_environment(finished), capture_output=True, text=True, check=False
    )
    assert {"truth", "maps", "masks", "body", "reconstruct"} <= planned(plan)
    assert counts(plan)["truth"] == 1
    assert counts(plan)["maps"] == counts(plan)["masks"] == 5

    def given(rule: str) -> str:
        """What the commands of a rule are given."""
        commands = "".join(re.findall(rf"-m soar {rule} .*", plan.stdout + plan.stderr))
        return "".join(re.findall(r'"given":"[^"]*"', commands))

    assert "/truth/body.npz" in given("body")
    assert "/maps/a180.zip" in given("masks")
    assert not given("keypoints") + given("normals")


def test_a_killed_stage_loses_only_itself(finished: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.glob("results/*/*/full/*/*") if path.is_file()}
    (finished / "slow").touch()
    options = [*OPTIONS, "reconstruct={steps: 11}"]
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "--config", *options]
    run = subprocess.Popen(
        command, cwd=finished, env=_environment(finished), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        deadline = time.monotonic() + 60
        while not (finished / "running").exists():
            assert time.monotonic() < deadline
            assert run.poll() is None, run.communicate()[0]
            time.sleep(0.1)
        for process in _stage_processes("reconstruct", str(finished)):
            os.kill(process, signal.SIGKILL)
        output = run.communicate(timeout=60)[0]
    finally:
        run.kill()
        (finished / "slow").unlink()
        (finished / "running").unlink()
    assert run.returncode != 0, output
    avatar = next(finished.glob("results/*/*/full")) / "reconstruct" / "avatar.safetensors"
    assert not avatar.exists()
    again = snakemake(finished, config=("reconstruct={steps: 11}",))
    assert again.returncode == 0, again.stdout + again.stderr
    assert avatar.exists()
    upstream = {"ingest", "frames", "keypoints", "masks", "calibrate", "body", "monocular", "crops", "normals", "paint"}
    after = {path: path.stat().st_mtime_ns for path in before}
    assert {path for path in before if path.parent.name in upstream and before[path] != after[path]} == set()
    assert snakemake(finished).returncode == 0


def _stage_processes(stage: str, folder: str) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes().split(b"\0")
                working = os.readlink(entry / "cwd")
            except OSError:
                continue
            if working == folder and command[1:4] == [b"-m", b"soar", stage.encode()]:
                found.append(int(entry.name))
    return found
