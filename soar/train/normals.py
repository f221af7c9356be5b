"""The task ``normals``: clothed normals, front and back, from a picture and the body's own normals."""

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
from soar.networks.export import export
from soar.networks.normal_inputs import INPUTS, SIGNATURE, batch
from soar.networks.normals import NormalNetwork, NormalNetworkSettings
from soar.perception.normal_network import NormalEstimator
from soar.report.pictures import colour_normals, grid
from soar.synthetic.settings import SyntheticSettings
from soar.train.evaluate_normals import NormalEvaluationSettings, evaluate, table
from soar.train.normal_samples import NormalSamples, NormalSampleSettings
from soar.train.task import Split

SIDES = (("front", "T_normal_F", "nml_F"), ("back", "T_normal_B", "nml_B"))
"""Name, input and output of either side."""

_SHOWN = 6  # samples on a sheet
_TRACED = 64  # px: height and width at which the network is traced and compared


@dataclasses.dataclass(frozen=True)
class NormalTaskSettings:
    """Node ``train`` of the task, besides the loop's.

    Attributes:
        network: its size.
        samples: what it learns from.
        synthetic: the people in them.
        evaluation: what is measured afterwards.
    """

    network: NormalNetworkSettings
    samples: NormalSampleSettings
    synthetic: SyntheticSettings
    evaluation: NormalEvaluationSettings


class NormalTask:
    """See :class:`soar.train.task.Task`.

    Args:
        node: the configuration of :class:`NormalTaskSettings`.
        models: folder of the model files.
    """

    def __init__(self, node: Mapping[str, Any], models: Path) -> None:
        self.settings = settings(NormalTaskSettings, node, "train")
        self.samples = NormalSamples(self.settings.samples, self.settings.synthetic, models)

    def network(self) -> nn.Module:
        """A network that gives back the body's normals."""
        return NormalNetwork(self.settings.network)

    def batch(self, split: Split, index: int) -> dict[str, np.ndarray]:
        """Inputs, ``nml_F``, ``nml_B`` (N, 3, H, W) and ``weight`` (N, 1, H, W); one picture size per batch."""
        return batch(self.samples.batch(split, index))

    def loss(self, network: nn.Module, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Mean of 1 - cos over the weighted pixels, both sides added; angles of network and body in degrees."""
        outputs = network(*[batch[name] for name in INPUTS])
        weight = batch["weight"]
        loss, figures = weight.new_zeros(()), {}
        for (side, given, name), got in zip(SIDES, outputs, strict=True):
            cosine = (got * batch[name]).sum(1, keepdim=True)
            loss = loss + mean_over(1 - cosine, weight)
            with torch.no_grad():
                before = (batch[given] * batch[name]).sum(1, keepdim=True)
                figures[side] = mean_over(degrees(cosine), weight)
                figures[f"body_{side}"] = mean_over(degrees(before), weight)
        return loss, figures

    def sheet(self, network: nn.Module, batch: dict[str, Tensor]) -> np.ndarray:
        """One row per sample: picture; of either side the body's normals, the network's, the truth."""
        planes = {name: value[:_SHOWN] for name, value in batch.items()}
        with torch.no_grad():
            outputs = network(*[planes[name] for name in INPUTS])
        inside = planes["weight"] > 0
        pictures = [(planes["image"] + 1) / 2]
        for (_, given, name), got in zip(SIDES, outputs, strict=True):
            pictures += [planes[given], got * inside, planes[name]]
        columns = [value.permute(0, 2, 3, 1).cpu().numpy() for value in pictures]
        cells = [
            columns[c][i] if c == 0 else colour_normals(columns[c][i])
            for i in range(len(columns[0]))
            for c in range(len(columns))
        ]
        return grid(cells, len(columns))

    def evaluate(self, path: Path | None, folder: Path, threads: int) -> None:
        """Print a table of angles, network and body, by body error and clothes, and leave it as ``evaluation.json``.

        Raises:
            ModelFileError: the network is missing, altered, or of another signature.
        """
        options = self.settings.evaluation
        estimator = NormalEstimator(path, 2 ** len(self.settings.network.widths), options.mirror, threads)
        result = evaluate(estimator, self.samples, options)
        write_json(folder / "evaluation.json", result)
        print(table(result))

    def export(self, network: nn.Module, path: Path, facts: Mapping[str, Any]) -> None:
        """Write the ONNX file and its record."""
        export(
            network,
            SIGNATURE,
            _TRACED,
            path,
            {"name": "normals", "licence": "Apache-2.0", "feeds": "normals of the clothed person", **facts},
        )


def degrees(cosine: Tensor) -> Tensor:
    """Angle whose cosine is given; rounding beyond 1 counts as 1."""
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def mean_over(value: Tensor, weight: Tensor) -> Tensor:
    """Mean of (N, 1, H, W) values by weight; zero where all weights are."""
    return (value * weight).sum() / weight.sum().clamp_min(1)
