"""How much nearer to the truth the network's normals are than the body's own, on people it was not trained on."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from typing import Any

import numpy as np

from soar.networks.normal_inputs import covered, fill, nearest_known
from soar.perception.normal_network import NormalEstimator
from soar.train.normal_samples import NormalSamples, Sample

FAMILY = "benchmark"


@dataclasses.dataclass(frozen=True)
class NormalEvaluationSettings:
    """What is measured.

    Attributes:
        seed: of the people, cameras and errors.
        count: pictures, the same ones for every amount.
        size: (height, width) of them, pixels.
        amounts: factors on the body's errors.
        mirror: as in the stage's settings.
    """

    seed: int
    count: int
    size: tuple[int, int]
    amounts: tuple[float, ...]
    mirror: bool


def evaluate(estimator: NormalEstimator, samples: NormalSamples, settings: NormalEvaluationSettings) -> dict[str, Any]:
    """Mean angles to the true clothed normals, degrees; pictures count alike.

    Returns:
        ``{amount: {"all" or what is worn: figures}}`` with the figures of :func:`angles`, and ``count`` of pictures.
    """
    result = {}
    for amount in settings.amounts:
        groups: dict[str, list[dict[str, float]]] = defaultdict(list)
        for index in range(settings.count):
            rng = np.random.default_rng([settings.seed, index])
            sample = samples.sample(rng, FAMILY, *settings.size, amount)
            figures = angles(estimator, sample)
            for group in ("all", *sample.outfit):
                groups[group].append(figures)
        result[f"{amount:g}"] = {group: _means(rows) for group, rows in sorted(groups.items())}
    return result


def angles(estimator: NormalEstimator, sample: Sample) -> dict[str, float]:
    """Mean angles to the truth of one picture, over the pixels whose truth is known.

    Returns:
        for either ``side``: ``side`` of the network; ``side_body`` of the body filled outward, both over the whole
        surface; ``side_where_body`` and ``side_body_where_body`` over the part that the body covers. NaN where there is
        nothing to compare.
    """
    outputs = estimator(sample.rgb, sample.mask, sample.body_front, sample.body_back)
    seen = sample.known
    body_there = covered(sample.body_front)
    nearest = nearest_known(body_there, seen)
    figures = {}
    pairs = (("front", sample.body_front, sample.front), ("back", sample.body_back, sample.back))
    for (side, body, truth), output in zip(pairs, outputs, strict=True):
        for name, normals in ((side, output), (f"{side}_body", fill(body, nearest))):
            angle = np.rad2deg(np.arccos(np.clip((normals * truth).sum(-1), -1, 1)))
            figures[name] = _mean(angle[seen])
            figures[f"{name}_where_body"] = _mean(angle[seen & body_there])
    return figures


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    means = {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}
    return {"count": len(rows), **means}


def table(result: dict[str, Any]) -> str:
    """The figures as aligned text: network against body, whole surface, and the change."""
    lines = [" error  worn                   n   front: body  network           back: body  network"]
    for amount, groups in result.items():
        for group, row in groups.items():
            cells = [f"{amount:>6} {group:<18} {row['count']:>4}"]
            for side, wide in (("front", 11), ("back", 10)):
                body, network = row[f"{side}_body"], row[side]
                cells.append(f"{body:>{wide}.2f} {network:>8.2f} {100 * (network / body - 1):>5.0f}%")
            lines.append("  ".join(cells))
    return "\n".join(lines)
