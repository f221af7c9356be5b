"""The task ``prior``: four views of a person, denoised together, from one picture and the posed body."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from soar.artifacts import write_json
from soar.config import settings
from soar.losses.lpips import Lpips
from soar.networks.diffusion import levels, noised
from soar.networks.export import export
from soar.networks.prior import PriorNetwork, PriorNetworkSettings
from soar.networks.prior_inputs import DOMAIN, VIEWS, signature
from soar.priors.mini import MiniPrior
from soar.report.pictures import grid
from soar.synthetic.settings import SyntheticSettings
from soar.train.evaluate_prior import Parts, PriorEvaluationSettings, evaluate, table
from soar.train.prior_samples import PriorSamples, PriorSampleSettings
from soar.train.task import Split

GIVEN = ("image", "geometry", "alpha", "carried", "flags")
"""Inputs of the network after the noisy views and the time."""

_SHOWN = 6  # samples on a sheet


@dataclasses.dataclass(frozen=True)
class PriorLossSettings:
    """Weights of the loss; pictures are in [-1, 1].

    Attributes:
        person: weight of a pixel's error where the person is.
        background: of a pixel's error where no person is.
        absolute: of the mean absolute error, beside the mean square.
        loudest: greatest weight of a sample; it is 1 / sigma^2 below.
        coverage: of the square error of the alpha.
        perceptual: of LPIPS with the VGG trunk, of one view of some samples that are not pure noise; judged is with
            another, AlexNet.
        looked_at: share of samples that it looks at.
    """

    person: float
    background: float
    absolute: float
    loudest: float
    coverage: float
    perceptual: float
    looked_at: float


@dataclasses.dataclass(frozen=True)
class PriorTaskSettings:
    """Node ``train`` of the task, besides the loop's.

    Attributes:
        network: its size.
        samples: what it learns from.
        loss: see there.
        synthetic: the people in them.
        evaluation: what is measured afterwards.
    """

    network: PriorNetworkSettings
    samples: PriorSampleSettings
    loss: PriorLossSettings
    synthetic: SyntheticSettings
    evaluation: PriorEvaluationSettings


class PriorTask:
    """See :class:`soar.train.task.Task`.

    Args:
        node: the configuration of :class:`PriorTaskSettings`.
        models: folder of the model files.
    """

    def __init__(self, node: Mapping[str, Any], models: Path) -> None:
        self.settings = settings(PriorTaskSettings, node, "train")
        self.samples = PriorSamples(self.settings.samples, self.settings.synthetic, models)
        self.models = models
        self._lpips: Lpips | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_lpips": None}

    def network(self) -> nn.Module:
        """A network that mixes all candidates alike."""
        return PriorNetwork(self.settings.network)

    def batch(self, split: Split, index: int) -> dict[str, np.ndarray]:
        """See :meth:`soar.train.prior_samples.PriorSamples.sample`; ``look`` (N,) is the view of a sample that the
        perceptual loss sees, -1 for none."""
        made = self.samples.batch(split, index)
        rng = np.random.default_rng([index, split == "validate"])
        look = rng.integers(VIEWS, size=len(made["flags"]))
        seldom = rng.uniform(size=len(look)) >= self.settings.loss.looked_at
        look[seldom | (made["flags"][:, DOMAIN] > 0)] = -1
        return made | {"look": look}

    def loss(self, network: nn.Module, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The error of the clean views; masked PSNR, dB, and LPIPS of what was looked at, 0 if nothing was."""
        options, target, covered = self.settings.loss, batch["target"], batch["coverage"]
        noisy = noised(target, batch["noise"], batch["time"])
        clean, coverage = network(noisy, batch["time"], *[batch[name] for name in GIVEN])
        _, sigma = levels(batch["time"])
        weight = sigma.square().reciprocal().clamp_max(options.loudest)
        error = (clean - target).square()
        where = options.background + (options.person - options.background) * covered
        pixels = (error + options.absolute * (clean - target).abs()) * where
        loss = (weight * pixels).mean() + options.coverage * (coverage - covered).square().mean()
        # Pure noise leaves the details open: the best guess is a mean, and asking it for sharpness costs error.
        looked = torch.nonzero((batch["look"] >= 0) & (batch["time"] < 1))[:, 0]
        distance = loss.new_zeros(())
        if len(looked):
            views = batch["look"][looked]
            pair = torch.cat([clean[looked, views], target[looked, views]])
            shown, truth = ((pair + 1) / 2).clamp(0, 1).chunk(2)
            distances = self._perceptual(pair.device)(shown, truth)
            loss = loss + options.perceptual * distances.sum() / len(clean)
            distance = distances.detach().mean()
        with torch.no_grad():
            # Pictures here span 2, so their squares are 4 times those of colours in [0, 1].
            squares = (error * covered).sum((1, 2, 3, 4)) / (12 * covered.sum((1, 2, 3, 4))).clamp_min(1)
        return loss, {"db": -10 * squares.clamp_min(1e-6).log10().mean(), "lpips": distance}

    def _perceptual(self, device: torch.device) -> Lpips:
        if self._lpips is None:
            self._lpips = Lpips.load(self.models / "lpips_vgg.safetensors", "vgg")
        return self._lpips.to(device)

    def sheet(self, network: nn.Module, batch: dict[str, Tensor]) -> np.ndarray:
        """One row per sample: the picture; of two opposite views and one between the noisy, the clean, the truth."""
        few = {name: value[:_SHOWN] for name, value in batch.items()}
        with torch.no_grad():
            noisy = noised(few["target"], few["noise"], few["time"])
            clean, _ = network(noisy, few["time"], *[few[name] for name in GIVEN])
        columns = [few["image"]]
        for view in (0, 1, 2):
            columns += [noisy[:, view], clean[:, view], few["target"][:, view]]
        pictures = [((column + 1) / 2).clamp(0, 1).permute(0, 2, 3, 1).cpu().numpy() for column in columns]
        cells = [np.uint8(np.rint(255 * column[row])) for row in range(len(pictures[0])) for column in pictures]
        return grid(cells, len(pictures))

    def evaluate(self, path: Path | None, folder: Path, threads: int) -> None:
        """Print a table of the prior and of colour transfer by hand, and leave the figures as ``evaluation.json``.

        Raises:
            ModelFileError: the network is missing, altered, or of another signature.
        """
        prior = MiniPrior(path, self.settings.samples.size, threads)
        parts = Parts.of(self.samples.people.wardrobe.body)
        lpips = Lpips.load(self.models / "lpips_alex.safetensors", "alex")
        result = evaluate(prior, self.samples, parts, lpips, self.settings.evaluation)
        write_json(folder / "evaluation.json", result)
        print(table(result))

    def export(self, network: nn.Module, path: Path, facts: Mapping[str, Any]) -> None:
        """Write the ONNX file and its record."""
        size = self.settings.samples.size
        export(
            network,
            signature(size),
            size,
            path,
            {"name": "prior", "licence": "Apache-2.0", "feeds": "completing what was never seen", **facts},
        )
