"""A training of one convolution, so that the loop can be tested in moments."""

import numpy as np
from torch import nn

from soar.artifacts import write_json
from soar.config import settings
from soar.train.loop import LoopSettings, Training
from tests.conftest import conf

LOOP = {
    "seed": 3, "steps": 12, "minutes": None, "device": "cpu", "workers": 0, "rate": 0.02, "warmup": 2, "decay": 0.01,
    "clip": 1.0, "average": 0.9, "save_seconds": 0.0, "record_every": 5, "validate_every": 6, "validation_batches": 2,
}  # fmt: skip


class TinyTask:
    """Learns to blur; counts what it was asked for."""

    def __init__(self, spoil_at=None):
        self.spoil_at, self.asked = spoil_at, []

    def network(self):
        return nn.Conv2d(1, 1, 3, padding=1)

    def batch(self, split, index):
        self.asked.append((split, index))
        rng = np.random.default_rng([split == "validate", index])
        x = rng.normal(size=(4, 1, 8, 8)).astype(np.float32)
        if split == "train" and index == self.spoil_at:
            x[:] = np.nan
        return {"x": x, "y": (x + np.roll(x, 1, -1)) / 2}

    def loss(self, network, batch):
        error = network(batch["x"]) - batch["y"]
        return error.square().mean(), {"worst": error.detach().abs().max()}

    def sheet(self, network, batch):
        return np.full((4, 4, 3), 7, np.uint8)

    def export(self, network, path, facts):
        write_json(path.with_suffix(".json"), {"weight": network.weight.flatten().tolist(), "facts": facts})


def training(folder, task=None, **changes):
    """A :class:`Training` of the tiny task with some settings changed."""
    node = LOOP | changes
    return Training(task or TinyTask(), settings(LoopSettings, node), {"task": "tiny", **node}, folder)


def shipped_loop():
    """Settings of the loop in the shipped configuration."""
    return {name: value for name, value in conf("train", "normals").items() if name in LOOP}
