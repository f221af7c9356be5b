"""A checkpoint belongs to one run, survives damage, and is written whole."""

import contextlib
from pathlib import Path

import torch

from soar.optimise.checkpoint import Checkpoint


def test_state_comes_back_to_the_same_run_only(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    assert Checkpoint(path, "a", 0).load() is None
    Checkpoint(path, "a", 0).save({"step": 3, "x": torch.arange(4)})
    state = Checkpoint(path, "a", 0).load()
    assert state is not None
    assert state["step"] == 3
    assert torch.equal(state["x"], torch.arange(4))
    assert Checkpoint(path, "b", 0).load() is None


def test_a_damaged_file_counts_as_none(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    checkpoint = Checkpoint(path, "a", 0)
    checkpoint.save({"step": 3, "x": torch.arange(1000)})
    whole = path.read_bytes()
    for damaged in (b"", b"nonsense", whole[: len(whole) // 2]):
        path.write_bytes(damaged)
        assert checkpoint.load() is None


def test_a_failed_save_keeps_the_last_state(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.pt", "a", 0)
    checkpoint.save({"step": 3})
    with contextlib.suppress(AttributeError, TypeError):
        checkpoint.save({"step": lambda: 4})
    state = checkpoint.load()
    assert state is not None
    assert state["step"] == 3
    assert [p.name for p in tmp_path.iterdir()] == ["state.pt"]


def test_due(tmp_path: Path) -> None:
    assert Checkpoint(tmp_path / "s", "a", 0).due()
    assert not Checkpoint(tmp_path / "s", "a", 1e6).due()
