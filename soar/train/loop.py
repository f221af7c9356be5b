"""The training loop: seeded, resumable to the bit, on whatever device there is, bounded by steps or by time."""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from soar.artifacts import write_image, write_json, write_text
from soar.devices import resolve_device
from soar.errors import ConfigError, NumericalError
from soar.optimise.checkpoint import Checkpoint
from soar.train.task import Split, Task
from soar.workflow import canonical


@dataclasses.dataclass(frozen=True)
class LoopSettings:
    """How long, how fast and where (top level of a node ``train``).

    Attributes:
        seed: of the weights.
        steps: steps after which training ends, or None.
        minutes: minutes of training, resumed runs added up, after which it ends, or None.
        device: ``cpu``, ``cuda``, or ``auto`` = an accelerator where there is one.
        workers: processes that make samples; 0 makes them between the steps.
        rate: highest learning rate; it rises over ``warmup`` steps and falls to nothing along half a cosine.
        warmup: steps.
        decay: weight decay of AdamW.
        clip: largest norm of the gradient.
        average: how much of the averaged weights each step keeps; they are what is validated and exported.
        save_seconds: least time between two saves of the state.
        record_every: steps between two rows of the curve.
        validate_every: steps between two validations, each with a sheet of samples.
        validation_batches: batches of each.
    """

    seed: int
    steps: int | None
    minutes: float | None
    device: str
    workers: int
    rate: float
    warmup: int
    decay: float
    clip: float
    average: float
    save_seconds: float
    record_every: int
    validate_every: int
    validation_batches: int

    def __post_init__(self) -> None:
        if self.steps is None and self.minutes is None:
            raise ConfigError(
                "training would never end", expected="train.steps or train.minutes", got="neither", cure="give one"
            )


# Settings that may change between a run and its continuation.
_FREE = ("steps", "minutes", "device", "workers", "save_seconds", "record_every", "validate_every")


class _Stream(Dataset[dict[str, Any]]):
    """Batches of a task by number; a worker computes on one thread."""

    def __init__(self, task: Task, split: Split) -> None:
        self.task, self.split = task, split

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.task.batch(self.split, index)


class Training:
    """One training in one folder, new or continued.

    The folder receives ``state.pt`` (to continue), ``curve.csv`` and ``curve.json`` (losses), ``sheet.jpg`` and, at the
    end, ``network.onnx`` with its record.

    Args:
        task: what is trained.
        settings: see :class:`LoopSettings`.
        config: everything that determines the result, for the state's key and the record.
        folder: where it lives.

    Raises:
        ConfigError: the folder holds the state of another training, or there is no such device.
    """

    def __init__(self, task: Task, settings: LoopSettings, config: dict[str, Any], folder: Path) -> None:
        self.task, self.settings, self.config, self.folder = task, settings, config, folder
        self.device = resolve_device(settings.device, "train.device")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            # Convolutions on a processor are a third faster with channels last.
            self.network = task.network().to(self.device, memory_format=torch.channels_last)
        self.averaged = copy.deepcopy(self.network).requires_grad_(False)
        self.optimiser = torch.optim.AdamW(self.network.parameters(), lr=settings.rate, weight_decay=settings.decay)
        self.step, self.samples, self.seconds = 0, 0, 0.0
        self.sums: dict[str, Any] = {}  # of the figures since the last row of the curve
        self.curve: list[dict[str, Any]] = []
        key = canonical({name: value for name, value in config.items() if name not in _FREE})
        self.checkpoint = Checkpoint(folder / "state.pt", key, settings.save_seconds)
        self._held_out: list[dict[str, Tensor]] = []
        state = self.checkpoint.load()
        if state is not None:
            self._restore(state)
        elif self.checkpoint.path.exists():
            raise ConfigError(
                f"{self.checkpoint.path} belongs to a training with other settings, or is damaged",
                cure="give another folder with --out, or delete the file to start again",
            )

    def run(self) -> None:
        """Train to the end and export.

        Raises:
            NumericalError: the loss is not finite; the last saved state stays.
        """
        if self.progress < 1:
            self._train()
        facts = {"config": self.config, "steps": self.step, "samples": self.samples, "seconds": round(self.seconds)}
        last = next((row for row in reversed(self.curve) if row["split"] == "validate"), {})
        self.task.export(self.averaged, self.folder / "network.onnx", {"training": facts, "validation": last})

    def _train(self) -> None:
        resumed, started = self.seconds, time.monotonic()
        for batch in self._batches("train", range(self.step, self.settings.steps or 1 << 40), self.settings.workers):
            self._descend(batch)
            self.seconds = resumed + time.monotonic() - started
            done = self.progress >= 1
            if done or self.step % self.settings.record_every == 0:
                self._record()
            if done or self.step % self.settings.validate_every == 0:
                self._validate()
            if done or self.checkpoint.due():
                self._save()
            if done:
                return

    @property
    def progress(self) -> float:
        """Share of the training that is done, by whichever of steps and time is nearer its end."""
        shares = [0.0]
        if self.settings.steps is not None:
            shares.append(self.step / self.settings.steps)
        if self.settings.minutes is not None:
            shares.append(self.seconds / (60 * self.settings.minutes))
        return min(1.0, max(shares))

    @property
    def rate(self) -> float:
        """Learning rate of the next step."""
        rising = min(1.0, (self.step + 1) / max(self.settings.warmup, 1))
        return self.settings.rate * rising * 0.5 * (1 + math.cos(math.pi * self.progress))

    def _batches(self, split: Split, indices: range, workers: int) -> Iterator[dict[str, Tensor]]:
        """Batches in order, whatever the number of workers."""
        loader = DataLoader(
            _Stream(self.task, split),
            sampler=indices,
            batch_size=None,
            num_workers=workers,
            # Forked workers of a process that has used an accelerator or thread pools may hang, and those of a fork
            # server outlive a training that is killed.
            multiprocessing_context="spawn" if workers else None,
            pin_memory=self.device.type != "cpu",
            worker_init_fn=_one_thread,
        )
        for batch in loader:
            yield {name: self._placed(value) for name, value in batch.items()}

    def _placed(self, value: Tensor) -> Tensor:
        layout = torch.channels_last if value.ndim == 4 else torch.preserve_format
        return value.to(self.device, non_blocking=True, memory_format=layout)

    def _descend(self, batch: dict[str, Tensor]) -> None:
        """One step; adds its figures to the sums of the next row."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate
        loss, figures = self.task.loss(self.network, batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.clip)
        if not bool(torch.isfinite(norm)):
            raise NumericalError(
                f"step {self.step} of the training: loss {float(loss.detach()):g}, gradient {float(norm):g}",
                expected="finite numbers",
                cure=f"lower train.rate; {self.checkpoint.path} keeps the last good state",
            )
        self.optimiser.step()
        self.step += 1
        self.samples += len(next(iter(batch.values())))
        # A short memory at first, so that the untrained weights are forgotten.
        keep = min(self.settings.average, self.step / (self.step + 9))
        with torch.no_grad():
            for mean, value in zip(self.averaged.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(value, 1 - keep)
        for name, value in {"steps": 1, "loss": loss.detach(), "gradient": norm, **figures}.items():
            self.sums[name] = self.sums.get(name, 0) + value

    def _record(self) -> None:
        steps = self.sums.pop("steps")
        self._row("train", {name: float(value) / steps for name, value in self.sums.items()})
        self.sums = {}

    def _validate(self) -> None:
        """Figures of the averaged weights on the same samples every time, and a sheet of the first of them."""
        if not self._held_out:
            self._held_out = list(self._batches("validate", range(self.settings.validation_batches), 0))
        sums: dict[str, float] = {}
        self.averaged.eval()
        with torch.no_grad():
            for batch in self._held_out:
                loss, figures = self.task.loss(self.averaged, batch)
                for name, value in {"loss": loss, **figures}.items():
                    sums[name] = sums.get(name, 0.0) + float(value) / len(self._held_out)
            write_image(self.folder / "sheet.jpg", self.task.sheet(self.averaged, self._held_out[0]))
        self._row("validate", sums)

    def _row(self, split: Split, figures: dict[str, float]) -> None:
        row = {"split": split, "step": self.step, "samples": self.samples, "seconds": round(self.seconds, 1)}
        self.curve.append({**row, "rate": self.rate, **figures})
        shown = (f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in self.curve[-1].items())
        print("  ".join(shown), flush=True)
        write_json(self.folder / "curve.json", self.curve)
        columns = list(dict.fromkeys(name for row in self.curve for name in row))
        lines = [",".join(columns), *[",".join(str(row.get(c, "")) for c in columns) for row in self.curve]]
        write_text(self.folder / "curve.csv", "\n".join(lines) + "\n")

    def _save(self) -> None:
        self.checkpoint.save(
            {
                "network": self.network.state_dict(),
                "averaged": self.averaged.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "step": self.step,
                "samples": self.samples,
                "seconds": self.seconds,
                "sums": self.sums,
                "curve": self.curve,
            }
        )

    def _restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.samples, self.seconds = state["step"], state["samples"], state["seconds"]
        self.sums, self.curve = state["sums"], state["curve"]


def _one_thread(worker: int) -> None:
    torch.set_num_threads(1)
