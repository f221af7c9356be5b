"""What users do wrong, and what machines do to them: a named error, what to do, exit code 2, nothing half-written.

Everything goes through ``python -m soar``'s own entry; one process is killed for real, one disk is really full.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import soar.artifacts
from soar.artifacts import read_npz, sha256_file, write_npz
from soar.cli import main
from soar.datasets.recordings import VideoFile
from soar.workflow import STAGES, composed, output_paths
from tests.conftest import ROOT, model_file
from tests.datasets.footage import camera_entry, picture, write_capture, write_images, write_video
from tests.report import toy

ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
CLIP = ROOT / "data" / "datasets" / "demo" / "cam02.mp4"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty project to work in; the command line's own environment variables are put back."""
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        monkeypatch.setenv(name, os.environ.get(name, "1"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(folder: Path = Path()) -> dict[str, str]:
    """Every file of the results, hidden ones too, with its digest; less the picture of a doubtful choice."""
    files = (path for path in (folder / "results").rglob("*") if path.is_file())
    return {str(path): sha256_file(path) for path in files if not path.name.endswith(".doubt.jpg")}


class Refused:
    """Runs a command line that must fail as a user's mistake does."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, error: str, *arguments: str, says: str, cure: str) -> str:
        """The message; it must be an ``error`` that ``says`` what and names the ``cure``."""
        before = made()
        self._capsys.readouterr()
        code = main([*arguments, "--threads", "1"])
        message = self._capsys.readouterr().err
        message = message[message.index("soar: ") :]
        assert code == 2, message
        assert message.startswith(f"soar: {error}: "), message
        assert says in message
        assert cure in message.rpartition("to do:")[2]
        assert "Traceback" not in message
        assert made() == before
        return message


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    return Refused(capsys)


def video(*more: str) -> list[str]:
    """Overrides for the clip or image folder ``clip``."""
    return ["dataset=video", "dataset.frames.fps=10", "dataset.frames.min_frames=2", *more]


def done(*arguments: str) -> None:
    """Run a command line that must succeed."""
    assert main([*arguments, "--threads", "1"]) == 0


# --- recordings -------------------------------------------------------------------------------------------------------


def _text(path: Path) -> None:
    path.write_text("this is no video\n" * 100)


def _empty(path: Path) -> None:
    path.touch()


def _half(path: Path) -> None:
    whole = write_video(path.with_name("whole.avi"), 28).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def _without_its_end(path: Path) -> None:
    """An .mp4 keeps its table of contents at the end: a broken copy has none."""
    whole = write_video(path.with_name("whole.mp4"), 20, code="mp4v").read_bytes()
    path.write_bytes(whole[: len(whole) * 3 // 4])


@pytest.mark.parametrize(
    ("name", "make", "says"),
    [
        ("clip.mp4", _text, "clip.mp4 cannot be opened as a video"),
        ("clip.mp4", _empty, "clip.mp4 cannot be opened as a video"),
        ("clip.mp4", _without_its_end, "clip.mp4 cannot be opened as a video"),
        ("clip.avi", _half, "promised frames can be decoded"),
    ],
)
def test_an_unreadable_or_truncated_video(name: str, make: Callable, says: str, folder: Path, refused: Refused) -> None:
    make(folder / name)
    refused(
        "InputError", "ingest", *video(f"dataset.path={name}"), says=says, cure="copy" if "promised" in says else "play"
    )


def test_a_video_that_shrinks_after_it_was_looked_at(folder: Path, refused: Refused) -> None:
    write_video(folder / "clip.avi", 28)
    done("ingest", *video("dataset.path=clip.avi"))
    _half(folder / "clip.avi")
    arguments = ["frames", *video("dataset.path=clip.avi"), "--camera", "camera"]
    refused("InputError", *arguments, says="ends before frame", cure="copy the file again")


def test_a_clip_of_one_frame(folder: Path, refused: Refused) -> None:
    write_video(folder / "clip.avi", 1)
    given = ["dataset=video", "dataset.path=clip.avi"]
    refused("InputError", "ingest", *given, says="too few: 1", cure="use a longer clip")
    # Who insists is told by the stage that cannot do it.
    model_file("manifest.json")
    link_models(folder)
    insists = [*given, "dataset.frames.min_frames=1"]
    done("ingest", *insists)
    done("frames", *insists, "--camera", "camera")
    arguments = ["keypoints", *insists, "--camera", "camera"]
    refused("SubjectError", *arguments, says="the clip is too short", cure="give a longer clip")


def test_a_calibration_that_does_not_match(folder: Path, refused: Refused) -> None:
    capture = write_capture(folder / "capture", {"a": camera_entry(3), "b": camera_entry(4)})
    given = ["dataset=cameras", "dataset.path=capture", "dataset.train=[a]", "dataset.frames.min_frames=2"]
    file, good = capture / "calibration.json", json.loads((capture / "calibration.json").read_text())

    def calibration(change: Callable[[dict[str, Any]], Any]) -> None:
        value = json.loads(json.dumps(good))
        change(value)
        file.write_text(json.dumps(value))

    done("ingest", *given)
    shutil.rmtree("results")
    calibration(lambda c: c["cameras"]["b"].update(size=[64, 48]))
    refused("CalibrationError", "ingest", *given, says="96x64, calibrated for 64x48", cure="dataset.size_mismatch")
    calibration(lambda c: c["cameras"].pop("a"))
    refused("ConfigError", "ingest", *given, says="camera split does not fit", cure="dataset.train")
    calibration(lambda c: c["cameras"]["b"].pop("K"))
    refused("CalibrationError", "ingest", *given, says="missing K", cure="docs/data.md")
    calibration(lambda c: c["cameras"]["b"]["T_cam_from_world"][0].__setitem__(3, 4000.0))
    refused("CalibrationError", "ingest", *given, says="m apart", cure="metres, not millimetres")
    calibration(lambda c: c["cameras"]["b"].update(T_cam_from_world=np.diag([-1.0, 1, 1, 1]).tolist()))
    refused("CalibrationError", "ingest", *given, says="is not a rotation", cure="check handedness")
    file.write_text(json.dumps(good)[:100])
    refused("CalibrationError", "ingest", *given, says="is not usable JSON", cure="docs/data.md")
    file.unlink()
    refused("CalibrationError", "ingest", *given, says="cannot be read", cure="docs/data.md")


# --- the person -------------------------------------------------------------------------------------------------------


def link_models(folder: Path, **replaced: bytes) -> None:
    """data/models as it is, but for the files of the stems ``replaced``."""
    models = folder / "data" / "models"
    for path in (ROOT / "data" / "models").rglob("*"):
        if path.is_file():
            link = models / path.relative_to(ROOT / "data" / "models")
            link.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix != ".json" and path.stem in replaced:
                link.write_bytes(replaced[path.stem])
            else:
                link.symlink_to(path)


def prepare(folder: Path, images: list[np.ndarray]) -> list[str]:
    """Frames of a clip of these RGB images, ready for the keypoint stage; its arguments."""
    model_file("manifest.json")
    (folder / "clip").mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / "clip" / f"{number}.png"), image[..., ::-1])
    given = video("dataset.path=clip")
    done("ingest", *given)
    done("frames", *given, "--camera", "camera")
    return ["keypoints", *given, "--camera", "camera"]


def man(count: int) -> list[np.ndarray]:
    """Frames of the demo, small."""
    if not CLIP.exists():
        pytest.skip("the demo footage is not there; `make demo` brings it")
    ids = range(0, 10 * count, 10)
    return [cv2.resize(image, (360, 640), interpolation=cv2.INTER_AREA) for image in VideoFile(CLIP).frames(ids)]


def test_nobody(folder: Path, refused: Refused) -> None:
    arguments = prepare(folder, [picture(index, 320, 240) for index in range(3)])
    link_models(folder)
    refused("SubjectError", *arguments, says="no person was found in any frame", cure="shows a person")


def test_several_people_until_one_is_chosen(folder: Path, refused: Refused) -> None:
    """The detector scores even a mirror image otherwise, so the limit of what is refused is lowered."""
    arguments = prepare(folder, [np.hstack([image, image[:, ::-1]]) for image in man(3)])
    arguments = [*arguments[:-2], "keypoints.subject.rival_error=0.4", "keypoints.subject.rival_frames=0.3"]
    camera = ["--camera", "camera"]
    link_models(folder)
    says = "several people are equally likely"
    message = refused("SubjectError", *arguments, *camera, says=says, cure="dataset.subject.point")
    assert next(Path("results").rglob("camera.doubt.jpg")).name in message
    points = json.loads("[" + message.split("shows people at ")[1].split("\n")[0].split(";")[0] + "]")
    assert len(points) == 2
    frame = int(message.split("frame ")[1].split()[0])
    for point in points:  # the cure is one
        chosen = [f"dataset.subject.point={json.dumps(point)}", f"dataset.subject.frame={frame}"]
        done("ingest", *arguments[1:], *chosen)
        done(*arguments, *chosen, *camera)
        keypoints = read_npz(next(Path("results").rglob("camera.npz")))["keypoints"]
        x = keypoints[frame, :25, 0][keypoints[frame, :25, 2] > 0.5]
        assert abs(np.median(x) - point[0]) < 90  # a quarter of the distance between the two


# --- model files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stem", ["pose_landmark_full", "pose_detection"])
def test_a_truncated_network(stem: str, folder: Path, refused: Refused) -> None:
    whole = model_file(f"{stem}.onnx").read_bytes()
    arguments = prepare(folder, [picture(0, 320, 240)] * 2)
    link_models(folder, **{stem: whole[: len(whole) // 2]})
    says = f"{stem}.onnx is not the file it should be"
    refused("ModelFileError", *arguments, says=says, cure="delete the file and run `python -m soar models fetch`")
    # Nor is one opened that nobody recorded.
    (folder / "data" / "models" / "records" / f"{stem}.onnx.json").unlink()
    refused("ModelFileError", *arguments, says=f"{stem}.onnx is not a usable ONNX network", cure="models fetch")
    (folder / "data" / "models" / f"{stem}.onnx").unlink()
    refused("ModelFileError", *arguments, says=f"{stem}.onnx is missing", cure="models fetch")


def job(stage: str, inputs: dict[str, Path], *overrides: str, place: str = "results") -> list[str]:
    """Arguments as the workflow passes them, for a stage on the toy sequence."""
    cfg = composed(overrides)
    return [
        stage,
        "--sequence=toy",
        "--cfg",
        json.dumps({"seed": 0} | {node: cfg[node] for node in STAGES[stage].config}),
        "--files",
        json.dumps(
            {
                "inputs": {name: str(inputs[name]) for name in STAGES[stage].reads},
                "outputs": output_paths(STAGES[stage], f"{place}/{stage}", None),
            }
        ),
    ]


@pytest.fixture
def toys(folder: Path) -> dict[str, Path]:
    """Inputs of every stage that makes or looks at an avatar."""
    inputs = toy.write_sequence(folder / "toy")
    crops = read_npz(inputs["crops"] / "front.npz")
    facing = np.zeros_like(crops["rgb"], dtype=np.int8)
    facing[..., 2] = np.where(crops["alpha"] > 127, -127, 0)
    write_npz(folder / "toy" / "normals" / "front.npz", {"front": facing, "back": -facing})
    (inputs["models"] / "manifest.json").write_text("{}")
    return inputs | {"normals": folder / "toy" / "normals"}


def test_truncated_weights_and_body(toys: dict[str, Path], refused: Refused) -> None:
    weights = toys["models"] / "lpips_alex.safetensors"
    whole = weights.read_bytes()
    weights.write_bytes(whole[: len(whole) // 2])
    refused("ModelFileError", *job("evaluate", toys), says="lpips_alex.safetensors", cure="models fetch")
    weights.unlink()
    refused("ModelFileError", *job("evaluate", toys), says="lpips_alex.safetensors", cure="models fetch")
    weights.write_bytes(whole)
    body = toys["body_model"].read_bytes()
    toys["body_model"].write_bytes(body[: len(body) // 2])
    refused("ModelFileError", *job("paint", toys), says="body_model.npz", cure="models")


def test_a_truncated_file_of_ours(toys: dict[str, Path], refused: Refused) -> None:
    avatar = toys["avatar"].read_bytes()
    toys["avatar"].write_bytes(avatar[: len(avatar) // 2])
    refused("ArtifactError", *job("occlusion", toys), says="avatar.safetensors", cure="delete")
    crops = (toys["crops"] / "front.npz").read_bytes()
    (toys["crops"] / "front.npz").write_bytes(crops[: len(crops) // 2])
    refused("ArtifactError", *job("paint", toys), says="front.npz", cure="delete")
    toys["sequence"].write_text(toys["sequence"].read_text()[:50])
    refused("ArtifactError", *job("paint", toys), says="sequence.json", cure="delete")


# --- configuration ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("overrides", "says"),
    [
        (["dataset.pth=clip.avi"], "pth"),
        (["+dataset.pth=clip.avi"], "unknown pth"),
        (["reconstruct.weights.l3=1"], "l3"),
        (["nonsense=1"], "nonsense"),
        (["body=nonsense"], "nonsense"),
        (["dataset=nonsense"], "nonsense"),
        (["dataset.frames.stride=often"], "dataset.frames.stride"),
        (["dataset.frames.stride=0"], "dataset.frames.stride"),
        (["dataset.path"], "dataset.path"),
        (["seed=[1"], "[1"),
    ],
)
def test_configuration_that_does_not_exist(overrides: list[str], says: str, folder: Path, refused: Refused) -> None:
    write_video(folder / "clip.avi", 8)
    given = ["dataset=video", "dataset.path=clip.avi"]
    refused("ConfigError", "ingest", *given, *overrides, says=says, cure="conf/")


def test_a_path_that_does_not_exist(refused: Refused) -> None:
    refused("InputError", "ingest", "dataset=video", "dataset.path=absent.mp4", says="absent.mp4", cure="dataset.path")
    refused("ConfigError", "ingest", "dataset=video", says="dataset.path is not set", cure="dataset=")


# --- the machine ------------------------------------------------------------------------------------------------------


def test_a_full_disk(folder: Path, refused: Refused, toys: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The system may tell only when the file is flushed."""
    write_images(folder / "clip", [1, 2, 3])
    given = video("dataset.path=clip")
    done("ingest", *given)

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(soar.artifacts.os, "fsync", full)
    for arguments in (["ingest", *given], ["frames", *given, "--camera", "camera"], job("paint", toys)):
        refused("StorageError", *arguments, says="No space left on device", cure="free disk space")


@contextlib.contextmanager
def small_disk(place: Path, kilobytes: int) -> Iterator[list[str]]:
    """A command that runs the rest of its arguments with a small file system at ``place``, seen by nobody else."""
    place.mkdir()
    script = f'mount -t tmpfs -o size={kilobytes}k tmpfs {place} && "$@"; code=$?; find {place} -type f; exit $code'
    own = ["unshare", "--user", "--map-root-user", "--mount"]
    if shutil.which("unshare") is None or subprocess.run([*own, "mount", "-t", "tmpfs", "x", place]).returncode:
        pytest.skip("this machine lets nobody mount a file system of one's own")
    yield [*own, "sh", "-c", script, "sh"]


@pytest.mark.parametrize(("stage", "kilobytes"), [("paint", 12), ("evaluate", 8)])
def test_a_disk_that_is_really_full(stage: str, kilobytes: int, folder: Path, toys: dict[str, Path]) -> None:
    with small_disk(folder / "small", kilobytes) as on_it:
        command = [*on_it, sys.executable, "-m", "soar", *job(stage, toys, place="small")]
        result = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert result.returncode == 2, result.stderr
    assert "soar: StorageError: cannot write" in result.stderr
    assert "free disk space" in result.stderr
    assert "Traceback" not in result.stderr
    left = {Path(line).name for line in result.stdout.splitlines() if line.startswith("/") or "small/" in line}
    assert not {name for name in left if name.startswith(".") or "provenance" in name}


def start(arguments: list[str]) -> subprocess.Popen[str]:
    """``python -m soar`` in a process of its own, which heeds Ctrl-C even where the tests run in the background."""
    return subprocess.Popen(
        [sys.executable, "-m", "soar", *arguments, "--threads", "1"],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def finish(process: subprocess.Popen[str]) -> None:
    """Wait for the process, which must succeed."""
    output = process.communicate(timeout=240)[0]
    assert process.returncode == 0, output


def end(process: subprocess.Popen[str], how: signal.Signals, when: Callable[[], bool]) -> None:
    """Send ``how`` as soon as ``when()``; the process must die of it, without a stack trace."""
    deadline = time.monotonic() + 60
    while not when():
        assert process.poll() is None, process.communicate(timeout=60)[0]
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(how)
    output = process.communicate(timeout=60)[0]
    assert process.returncode == (130 if how == signal.SIGINT else -how), output
    assert "Traceback" not in output


def test_a_stage_that_is_killed_again_and_again_ends_as_if_it_had_not_been(folder: Path, toys: dict[str, Path]) -> None:
    options = [
        *("reconstruct.steps=80", "reconstruct.reskin_every=4", "reconstruct.checkpoint_seconds=0"),
        *("avatar.subdivisions=0", "avatar.longest_edge=1", "avatar.attributes=explicit"),
        *("reconstruct.weights.lpips=0", "reconstruct.weights.normal_lpips=0"),
    ]
    arguments = job("reconstruct", toys, *options)
    place = folder / "results" / "reconstruct"
    state = place / ".provenance.scratch" / "state.pt"
    for how in (signal.SIGKILL, signal.SIGINT):
        before = state.stat().st_mtime_ns if state.exists() else 0
        end(start(arguments), how, lambda old=before: state.exists() and state.stat().st_mtime_ns > old)
        assert [path.name for path in place.iterdir()] == [".provenance.scratch"]
    finish(start(arguments))
    assert not state.parent.exists()
    finish(start(job("reconstruct", toys, *options, place="whole")))
    avatar = Path("reconstruct") / "avatar.safetensors"
    # Digests: pytest explains how two long strings of bytes differ, for hours.
    assert sha256_file(folder / "results" / avatar) == sha256_file(folder / "whole" / avatar)


def test_what_a_killed_writer_leaves_is_hidden_and_removed(folder: Path) -> None:
    (folder / "clip").mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), np.uint8)
    cv2.imwrite(str(folder / "clip" / "0.png"), noise)
    for number in range(1, 20):
        (folder / "clip" / f"{number}.png").symlink_to("0.png")
    given = video("dataset.path=clip")
    done("ingest", *given)
    arguments = ["frames", *given, "--camera", "camera"]
    place = folder / "results" / "video" / "clip" / "full" / "frames"
    end(start(arguments), signal.SIGKILL, lambda: any(path.stat().st_size for path in place.glob(".*.zip")))
    (left,) = place.iterdir()
    assert left.name.startswith(".camera.")
    done(*arguments)
    assert {path.name for path in place.iterdir()} == {f"camera.{x}" for x in FRAMES_LEAVE}


FRAMES_LEAVE = ("zip", "health.json", "evidence.jpg", "provenance.json")
