"""The caption stage as the workflow runs it: files, evidence, and a key that is in none of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from soar.artifacts import read_json, write_npz
from soar.cli import execute
from soar.datasets.sequence import Sequence, Source, Subject
from soar.errors import ServiceError, SubjectError
from soar.health import Health
from soar.workflow import STAGES, output_paths
from tests.body import stickman
from tests.caption import people
from tests.caption.service import KEY, SENTENCE, Server, refuses, says
from tests.conftest import conf

FRAMES = 5


def outfit(bone: str, share: float) -> tuple[int, int, int]:
    """Red above, blue below, brown hair."""
    if bone == "head":
        return (95, 62, 42) if share < 0.3 else people.SKIN
    if bone in ("spine04", "upperarm01", "lowerarm01"):
        return (185, 30, 40)
    return people.SKIN if bone == "wrist" else (40, 85, 175)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of a sequence of one training and one evaluation camera, which has none."""
    folder = tmp_path_factory.mktemp("caption")
    seen = people.footage(outfit, FRAMES).sightings
    cameras = tuple(stickman.cameras(2))
    p = seen[0].pinhole
    arrays = {
        "rgb": np.stack([sighting.rgb for sighting in seen]),
        "alpha": np.stack([sighting.alpha for sighting in seen]),
        "K": np.tile([[p.fx, 0, p.cx], [0, p.fy, p.cy], [0, 0, 1]], (FRAMES, 1, 1)),
        "T_cam_from_world": cameras[0].T_cam_from_world,
        "frame_index": np.arange(FRAMES),
    }
    write_npz(folder / "crops" / "cam0.npz", arrays)
    Sequence(
        name="someone", fps=10.0, frame_ids=tuple(range(FRAMES)), up=np.array([0.0, 0, 1]), train=("cam0",),
        eval=("cam1",), cameras=cameras, sources=(Source("cam0", "cam0.mp4", "0" * 64),),
        subject=Subject(None, None, 0, None, "cam0"), remarks=(),
    ).write(folder / "sequence.json")  # fmt: skip
    model = people.body()
    model.save(folder / "body_model.npz")
    people.motion(model, FRAMES).write(folder / "body.npz")
    files = {"sequence": "sequence.json", "body_model": "body_model.npz", "body": "body.npz", "crops": "crops"}
    return {name: folder / file for name, file in files.items()}


def run(inputs: dict[str, Path], folder: Path, option: str, **changed: Any) -> dict[str, Path]:
    assert STAGES["caption"].reads.keys() == inputs.keys()
    outputs = {name: Path(path) for name, path in output_paths(STAGES["caption"], str(folder), None).items()}
    cfg = {"seed": 0, "caption": conf("caption", option) | changed, "raster": conf("raster", "default")}
    execute("caption", inputs, outputs, cfg, sequence="someone", camera=None, threads=1)
    assert cv2.imread(str(outputs["evidence"])).shape[1] > 300
    return outputs


def test_the_measured_caption(inputs: dict[str, Path], tmp_path: Path) -> None:
    outputs = run(inputs, tmp_path, "template", frames=3)
    caption = read_json(outputs["caption"])
    assert caption["text"] == "A person with brown hair, a long-sleeved red top, blue trousers, blue shoes."
    assert caption["provider"] == "template"
    assert caption["evidence"]["photographs"] == ["cam0 0", "cam0 2", "cam0 4"]
    assert caption["evidence"]["lower"]["reach"] == 1
    numbers = Health.read(outputs["health"]).numbers
    assert numbers["parts"]["value"] == 4
    assert numbers["words"]["value"] == 13


def test_the_users_words(inputs: dict[str, Path], tmp_path: Path) -> None:
    caption = read_json(run(inputs, tmp_path, "text", text="A man in red and blue.")["caption"])
    assert caption == {
        "text": "A man in red and blue.",
        "provider": "text",
        "evidence": {"photographs": ["cam0 0", "cam0 1", "cam0 3", "cam0 4"]},
    }


def test_the_key_is_in_no_file(inputs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("A_KEY", KEY)
    with Server((refuses(500, KEY), says(SENTENCE), refuses(401, KEY))).running() as server:
        service = conf("caption", "openai")["service"] | {
            "base_url": server.url,
            "key_variable": "A_KEY",
            "backoff_s": 0.01,
        }
        outputs = run(inputs, tmp_path, "openai", service=service)
        caption = read_json(outputs["caption"])
        assert caption["text"] == SENTENCE
        assert len(caption["evidence"]["photographs"]) == 4
        assert read_json(outputs["provenance"])["config"]["caption"]["service"]["key_variable"] == "A_KEY"
        with pytest.raises(ServiceError):
            run(inputs, tmp_path / "refused", "openai", service=service)
    assert not list((tmp_path / "refused").rglob("*.*"))
    written = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert len(written) == 4
    assert not any(KEY[3:].encode() in content for content in written)


def test_crops_without_a_person(inputs: dict[str, Path], tmp_path: Path) -> None:
    with np.load(inputs["crops"] / "cam0.npz") as crops:
        write_npz(tmp_path / "crops" / "cam0.npz", {**crops, "alpha": np.zeros_like(crops["alpha"])})
    with pytest.raises(SubjectError, match="no crop"):
        run(inputs | {"crops": tmp_path / "crops"}, tmp_path, "template")
