"""The loop: it learns, resumes to the bit, ends when it should, and refuses what it should."""

import csv
import math

import pytest
import torch

from soar.artifacts import read_json
from soar.config import settings
from soar.errors import ConfigError, NumericalError
from soar.train.loop import LoopSettings
from tests.train.tiny import LOOP, TinyTask, shipped_loop, training


class Killed(Exception):
    pass


class KilledTask(TinyTask):
    """Dies when asked for a certain batch, as a process that is killed does: nothing is saved on the way out."""

    def __init__(self, at):
        super().__init__()
        self.at = at

    def batch(self, split, index):
        if split == "train" and index == self.at:
            raise Killed
        return super().batch(split, index)


def without_time(curve):
    return [{name: value for name, value in row.items() if name != "seconds"} for row in curve]


def test_it_learns_and_leaves_its_files(tmp_path):
    run = training(tmp_path, steps=60)
    run.run()
    curve = read_json(tmp_path / "curve.json")
    assert [row["step"] for row in curve if row["split"] == "train"] == list(range(5, 61, 5))
    assert [row["step"] for row in curve if row["split"] == "validate"] == list(range(6, 61, 6))
    losses = [row["loss"] for row in curve if row["split"] == "validate"]
    assert losses[-1] < 0.5 * losses[0]
    with open(tmp_path / "curve.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(curve)
    assert float(rows[-1]["loss"]) == pytest.approx(curve[-1]["loss"])
    assert (tmp_path / "sheet.jpg").stat().st_size > 0
    facts = read_json(tmp_path / "network.json")["facts"]
    assert facts["training"]["steps"] == 60
    assert facts["training"]["samples"] == 240
    assert facts["validation"]["loss"] == losses[-1]


@pytest.mark.parametrize("at", [1, 5, 7, 11])
def test_a_killed_run_resumes_to_the_bit(tmp_path, at):
    training(tmp_path / "whole").run()
    with pytest.raises(Killed):
        training(tmp_path / "killed", KilledTask(at)).run()
    task = TinyTask()
    training(tmp_path / "killed", task).run()
    assert min(index for split, index in task.asked if split == "train") == at  # nothing is done twice
    whole, resumed = (read_json(tmp_path / name / "network.json") for name in ("whole", "killed"))
    assert whole["weight"] == resumed["weight"]
    curves = [without_time(read_json(tmp_path / name / "curve.json")) for name in ("whole", "killed")]
    assert curves[0] == curves[1]


def test_workers_do_not_change_the_result(tmp_path):
    training(tmp_path / "0").run()
    training(tmp_path / "2", workers=2).run()
    assert read_json(tmp_path / "0/network.json")["weight"] == read_json(tmp_path / "2/network.json")["weight"]


def test_seed_changes_the_weights(tmp_path):
    first, same, other = (training(tmp_path / name, seed=seed) for name, seed in (("a", 3), ("b", 3), ("c", 4)))
    assert torch.equal(first.network.weight, same.network.weight)
    assert not torch.equal(first.network.weight, other.network.weight)


def test_time_ends_it_and_more_time_continues_it(tmp_path):
    training(tmp_path, steps=None, minutes=0.3 / 60).run()
    steps = read_json(tmp_path / "network.json")["facts"]["training"]["steps"]
    run = training(tmp_path, steps=None, minutes=1e-9)
    assert run.progress == 1
    run.run()  # nothing left to do but export
    assert read_json(tmp_path / "network.json")["facts"]["training"]["steps"] == steps
    training(tmp_path, steps=steps + 3).run()
    assert read_json(tmp_path / "network.json")["facts"]["training"]["steps"] == steps + 3


def test_rate_rises_then_falls(tmp_path):
    run = training(tmp_path, steps=100, warmup=10)
    rates = []
    for run.step in range(100):
        rates.append(run.rate)
    assert rates[0] == pytest.approx(0.1 * 0.02, rel=0.01)
    assert max(rates) == pytest.approx(0.02, rel=0.05)
    assert rates[50] == pytest.approx(0.01)
    assert rates[-1] < 0.0001
    assert rates[20:] == sorted(rates[20:], reverse=True)


def test_average_follows_the_weights(tmp_path):
    run = training(tmp_path, average=0.5, steps=8)
    mean = run.averaged.weight.clone()
    for step in range(1, 4):
        run._descend({name: torch.from_numpy(value) for name, value in run.task.batch("train", step).items()})
        keep = min(0.5, step / (step + 9))
        mean = keep * mean + (1 - keep) * run.network.weight.detach()
        assert torch.allclose(run.averaged.weight, mean, atol=1e-7)


def test_not_a_number_stops_and_keeps_the_last_state(tmp_path):
    with pytest.raises(NumericalError, match="step 7"):
        training(tmp_path, TinyTask(spoil_at=7)).run()
    run = training(tmp_path)
    assert run.step == 7
    assert all(math.isfinite(value) for value in run.network.weight.flatten().tolist())


def test_another_training_is_not_overwritten(tmp_path):
    training(tmp_path).run()
    with pytest.raises(ConfigError, match="other settings"):
        training(tmp_path, rate=0.5)
    (tmp_path / "state.pt").write_bytes(b"damaged")
    with pytest.raises(ConfigError, match="damaged"):
        training(tmp_path)


def test_settings():
    with pytest.raises(ConfigError, match="never end"):
        settings(LoopSettings, LOOP | {"steps": None})
    assert set(shipped_loop()) == set(LOOP)
    settings(LoopSettings, shipped_loop())
