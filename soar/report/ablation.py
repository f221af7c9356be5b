"""Variants of the method beside each other, and whether they relate as expected."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Literal

from soar.errors import ConfigError
from soar.report.tables import MEASURES, MISSING, Scores, Table, figure, title

REFINED = "ours"
"""The method that is a variant's finished avatar."""

SURFACE = "surface"
"""Stands for the split where a figure is of the surfels themselves and no camera takes part."""

COLUMNS: dict[str, str] = {
    "occluded_mpsnr": "eval",
    "occluded_mpsnr_calibrated": "eval",
    "occluded_mlpips": "eval",
    "psnr": "eval",
    "lpips": "eval",
    "visible_mpsnr": "train",
    "saturation_gap": SURFACE,
}
"""Figures of the table and the split each is taken from, in the order of the columns."""

NOTE = (
    "Means over the evaluation cameras of each sequence, or its training cameras where the head says so, then over "
    "sequences. The column of sequences counts them; one without the figure is left out of its mean. Every variant is "
    "measured in its own run: by its own occlusion, on pixels that all avatars of that run cover. Saturation gap: of "
    "the refined avatar's surfels, the difference in saturation between those never seen and those seen, over the "
    "latter's."
)
_PREFIX = {"train": "training: "}
_SOURCE = {"paper": "as in the paper", "ours": "our own aim"}


@dataclasses.dataclass(frozen=True)
class RowSettings:
    """A row: its name, the variant and method its figures are of, and its meaning in a few words."""

    name: str
    variant: str
    method: str
    meaning: str


@dataclasses.dataclass(frozen=True)
class Expectation:
    """How two rows should relate in one column.

    Attributes:
        left: name of a row.
        right: name of another row, or a fixed value in the unit of the metric.
        metric: one of :data:`COLUMNS`.
        direction: of ``left`` against ``right``.
        margin: in the unit of the metric. ``above``, ``below``: the least lead; 0 asks for any, a negative one lets
            ``left`` fall behind by as much. ``near``: the largest distance.
        source: who expects it.
        why: known reason where it does not hold.

    Raises:
        ConfigError: the metric is no column, or the margin of ``near`` is negative.
    """

    left: str
    right: str | float
    metric: str
    direction: Literal["above", "below", "near"]
    margin: float
    source: Literal["paper", "ours"]
    why: str | None

    def __post_init__(self) -> None:
        cure = "correct report.ablation.expectations"
        if self.metric not in COLUMNS:
            raise ConfigError(
                "an expectation's metric is no column", expected=", ".join(COLUMNS), got=self.metric, cure=cure
            )
        if self.direction == "near" and self.margin < 0:
            raise ConfigError("a distance is negative", expected="0 or more", got=f"{self.margin:g}", cure=cure)

    @property
    def claim(self) -> str:
        """In words."""
        metric = MEASURES[self.metric]
        amount = f"{abs(self.margin):g} {metric.unit}".strip()
        if self.direction == "near":
            relation = f"within {amount} of"
        elif self.margin > 0:
            relation = f"at least {amount} {self.direction}"
        elif self.margin < 0:
            relation = f"at most {amount} {'below' if self.direction == 'above' else 'above'}"
        else:
            relation = self.direction
        right = self.right if isinstance(self.right, str) else f"{self.right:g}"
        return f"{_prefix(self.metric)}{metric.title} of {self.left} {relation} {right}"

    def holds(self, left: float, right: float) -> bool:
        """Whether two values relate as expected."""
        if self.direction == "near":
            return abs(left - right) <= self.margin
        lead = left - right if self.direction == "above" else right - left
        return lead >= self.margin if self.margin else lead > 0


@dataclasses.dataclass(frozen=True)
class AblationSettings:
    """The node ``report.ablation``."""

    rows: tuple[RowSettings, ...]
    expectations: tuple[Expectation, ...]


@dataclasses.dataclass(frozen=True)
class Verdict:
    """An expectation judged: ``holds`` is None where a value is missing; ``text`` has claim, values, source, reason."""

    holds: bool | None
    text: str

    @property
    def words(self) -> str:
        """The judgement alone."""
        return "not measured" if self.holds is None else "holds" if self.holds else "does not hold"


@dataclasses.dataclass(frozen=True)
class Ablation:
    """What the section shows; ``note`` says how the table came about."""

    table: Table
    verdicts: tuple[Verdict, ...]
    note: str


def ablation(scores: Sequence[Scores], settings: AblationSettings) -> Ablation | None:
    """The section, or None where there are fewer than two variants.

    Args:
        scores: of all sequences, variants and methods; figures of the surface have the split :data:`SURFACE`.
        settings: known rows in their order, and what is expected. Variants without a row of their own come last.
    """
    variants = tuple(dict.fromkeys(s.variant for s in scores))
    if len(variants) < 2:
        return None
    known = {(row.variant, row.method) for row in settings.rows}
    others = (RowSettings(name, name, REFINED, MISSING) for name in variants if (name, REFINED) not in known)
    rows: list[tuple[str, ...]] = []
    values: dict[str, dict[str, float | None]] = {}
    for row in (*settings.rows, *others):
        members = [s for s in scores if (s.variant, s.method) == (row.variant, row.method)]
        if members:
            values[row.name] = {metric: _mean(members, metric) for metric in COLUMNS}
            cells = (figure(value, metric) for metric, value in values[row.name].items())
            rows.append((row.name, row.meaning, str(len({s.sequence for s in members})), *cells))
    head = ("row", "meaning", "sequences", *(f"{_prefix(metric)}{title(metric)}" for metric in COLUMNS))
    verdicts = tuple(_verdict(expectation, values) for expectation in settings.expectations)
    return Ablation(Table(head, tuple(rows), 2), verdicts, NOTE)


def _prefix(metric: str) -> str:
    return _PREFIX.get(COLUMNS[metric], "")


def _mean(members: Sequence[Scores], metric: str) -> float | None:
    """Over the cameras of each sequence first, so that a sequence of many cameras weighs no more than one of few."""
    sequences: dict[str, list[float]] = {}
    for s in members:
        value = s.values.get(metric)
        if s.split == COLUMNS[metric] and value is not None:
            sequences.setdefault(s.sequence, []).append(value)
    return fmean(map(fmean, sequences.values())) if sequences else None


def _verdict(expectation: Expectation, values: Mapping[str, Mapping[str, float | None]]) -> Verdict:
    def value(row: str) -> float | None:
        return values[row][expectation.metric] if row in values else None

    left = value(expectation.left)
    right = value(expectation.right) if isinstance(expectation.right, str) else expectation.right
    holds = None if left is None or right is None else expectation.holds(left, right)
    shown = f"{expectation.left} {figure(left, expectation.metric)}"
    if isinstance(expectation.right, str):
        shown += f", {expectation.right} {figure(right, expectation.metric)}"
    text = f"{expectation.claim} ({_SOURCE[expectation.source]}): {shown}."
    return Verdict(holds, f"{text} {expectation.why}" if holds is False and expectation.why else text)
