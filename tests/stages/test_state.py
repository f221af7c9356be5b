"""Whose a saved state is: whatever changes the result changes the key, and nothing else does."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from soar.artifacts import write_json
from soar.stages import Job
from soar.stages._state import state_key

Inputs = dict[str, Path]


def job(folder: Path) -> Job:
    return Job("walk", None, 0, 1, folder / "scratch")


def cfg() -> dict[str, Any]:
    return {"reconstruct": {"steps": 10, "rates": {"positions": 1e-3, "colours": 1e-2}}, "raster": {"cull": True}}


@pytest.fixture
def inputs(tmp_path: Path) -> Inputs:
    """A file, a folder of one file per camera, and the models."""
    write_json(tmp_path / "caption.json", {"text": "a man in red"})
    (tmp_path / "paint.safetensors").write_bytes(b"surfels")
    for folder in ("crops", "models"):
        (tmp_path / folder).mkdir()
    for name in ("cam01", "cam02"):
        (tmp_path / "crops" / f"{name}.npz").write_bytes(name.encode())
    (tmp_path / "models" / "lpips.safetensors").write_bytes(b"weights")
    return {
        "crops": tmp_path / "crops",
        "caption": tmp_path / "caption.json",
        "paint": tmp_path / "paint.safetensors",
        "models": tmp_path / "models",
    }


def test_the_key_is_a_digest_that_repeats(inputs: Inputs, tmp_path: Path) -> None:
    key = state_key(inputs, cfg(), job(tmp_path))
    assert len(bytes.fromhex(key)) == 32
    assert state_key(inputs, cfg(), job(tmp_path)) == key


@pytest.mark.parametrize(
    "change",
    [
        lambda node: node["reconstruct"].update(steps=11),
        lambda node: node["reconstruct"]["rates"].update(positions=2e-3),
        lambda node: node["raster"].update(cull=False),
        lambda node: node["raster"].pop("cull"),
        lambda node: node.update(avatar={}),
    ],
    ids=["number", "deep", "flag", "less", "more"],
)
def test_another_configuration_is_another_run(inputs: Inputs, tmp_path: Path, change: Callable[[dict], Any]) -> None:
    other = cfg()
    change(other)
    assert state_key(inputs, other, job(tmp_path)) != state_key(inputs, cfg(), job(tmp_path))


@pytest.mark.parametrize("change", [{"seed": 1}, {"sequence": "run"}, {"code": "0123"}])
def test_another_seed_sequence_or_code_is_another_run(inputs: Inputs, tmp_path: Path, change: dict[str, Any]) -> None:
    mine = job(tmp_path)
    assert state_key(inputs, cfg(), dataclasses.replace(mine, **change)) != state_key(inputs, cfg(), mine)


def swap(inputs: Inputs) -> None:
    first, second = (inputs["crops"] / f"{name}.npz" for name in ("cam01", "cam02"))
    content = first.read_bytes(), second.read_bytes()
    first.write_bytes(content[1])
    second.write_bytes(content[0])


@pytest.mark.parametrize(
    "change",
    [
        lambda inputs: write_json(inputs["caption"], {"text": "a man in blue"}),
        lambda inputs: inputs["paint"].write_bytes(b"surfelS"),
        lambda inputs: (inputs["crops"] / "cam02.npz").write_bytes(b"other"),
        lambda inputs: (inputs["crops"] / "cam02.npz").unlink(),
        lambda inputs: (inputs["crops"] / "cam03.npz").write_bytes(b"cam01"),
        lambda inputs: (inputs["crops"] / "cam01.npz").rename(inputs["crops"] / "cam00.npz"),
        swap,
        lambda inputs: inputs.pop("paint"),
        lambda inputs: inputs.update(unrefined=inputs.pop("paint")),
    ],
    ids=["json", "tensors", "in a folder", "less", "more", "renamed", "swapped", "no input", "another input"],
)
def test_other_inputs_are_another_run(inputs: Inputs, tmp_path: Path, change: Callable[[Inputs], Any]) -> None:
    before = state_key(inputs, cfg(), job(tmp_path))
    change(inputs)
    assert state_key(inputs, cfg(), job(tmp_path)) != before


def test_what_does_not_change_the_result_is_the_same_run(inputs: Inputs, tmp_path: Path) -> None:
    mine = job(tmp_path)
    before = state_key(inputs, cfg(), mine)
    (inputs["models"] / "lpips.safetensors").write_bytes(b"others")
    (inputs["models"] / "manifest.json").write_bytes(b"{}")
    (inputs["crops"] / "evidence.jpg").write_bytes(b"a picture")
    (inputs["crops"] / "cam01.provenance.json").write_bytes(b"{}")
    (inputs["crops"] / ".scratch").mkdir()
    (inputs["crops"] / ".scratch" / "state.npz").write_bytes(b"half done")
    assert state_key(inputs, cfg(), mine) == before
    assert state_key({name: inputs[name] for name in inputs if name != "models"}, cfg(), mine) == before
    assert state_key(dict(reversed(inputs.items())), dict(reversed(cfg().items())), mine) == before
    elsewhere = dataclasses.replace(mine, threads=4, scratch=tmp_path / "elsewhere")
    assert state_key(inputs, cfg(), elsewhere) == before
    moved = {name: tmp_path / "moved" / path.name for name, path in inputs.items()}
    for name, path in inputs.items():
        moved[name].parent.mkdir(exist_ok=True)
        (shutil.copytree if path.is_dir() else shutil.copy)(path, moved[name])
    assert state_key(moved, cfg(), mine) == before
