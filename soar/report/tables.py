"""Tables as rows of text, and as Markdown and CSV."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Mapping, Sequence
from typing import Any

from soar.report.evaluation import METRICS, Metric

MISSING = "–"

MEASURES: dict[str, Metric] = METRICS | {"saturation_gap": Metric("saturation gap", "", False, 3)}
"""Everything that a table of figures may show: what is measured in a camera, and what of the surface itself."""


@dataclasses.dataclass(frozen=True)
class Table:
    """Head and rows of text; ``text_columns`` first columns are words, the others numbers.

    ``best`` names the cells (row, column) to stand out.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text_columns: int
    best: frozenset[tuple[int, int]] = frozenset()

    def markdown(self) -> str:
        """GitHub-flavoured Markdown."""

        def line(cells: Sequence[str]) -> str:
            return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

        rule = ["---" if i < self.text_columns else "---:" for i in range(len(self.head))]
        return "\n".join([line(self.head), line(rule), *map(line, self.rows)])


def figure(value: float | None, metric: str) -> str:
    """A metric's value as text."""
    return MISSING if value is None else f"{value:.{MEASURES[metric].digits}f}"


def title(metric: str) -> str:
    """A metric's column head: name, unit, direction."""
    m = MEASURES[metric]
    return f"{m.title}{f' [{m.unit}]' if m.unit else ''} {'↑' if m.higher_is_better else '↓'}"


@dataclasses.dataclass(frozen=True)
class Scores:
    """The figures of one method in one camera of one sequence and variant."""

    sequence: str
    variant: str
    camera: str
    split: str
    method: str
    values: Mapping[str, float | None]


def scores_of(sequence: str, variant: str, metrics: Mapping[str, Any]) -> list[Scores]:
    """The rows of one ``metrics.json``."""
    return [
        Scores(sequence, variant, name, camera["split"], method, values)
        for name, camera in sorted(metrics["cameras"].items(), key=lambda item: (item[1]["split"] != "train", item[0]))
        for method, values in camera["methods"].items()
    ]


def score_table(scores: Sequence[Scores]) -> Table:
    """All rows; the best method of a camera stands out where methods differ."""
    rows = [
        (s.sequence, s.variant, s.camera, s.split, s.method, *(figure(s.values[m], m) for m in METRICS)) for s in scores
    ]
    groups: dict[tuple[str, str], list[int]] = {}
    for i, s in enumerate(scores):
        groups.setdefault((s.sequence, s.camera), []).append(i)
    best = set()
    for members in groups.values():
        for column, (name, metric) in enumerate(METRICS.items(), start=5):
            known = {i: scores[i].values[name] for i in members if scores[i].values[name] is not None}
            texts = {rows[i][column] for i in known}
            if len(texts) > 1:
                top = (max if metric.higher_is_better else min)(known.values())
                best |= {(i, column) for i, value in known.items() if value == top}
    head = ("sequence", "variant", "camera", "split", "method", *map(title, METRICS))
    return Table(head, tuple(rows), 5, frozenset(best))


def mean_table(scores: Sequence[Scores]) -> Table:
    """Means over cameras and sequences of each variant, method and split."""
    groups: dict[tuple[str, str, str], list[Scores]] = {}
    for s in scores:
        groups.setdefault((s.split, s.variant, s.method), []).append(s)
    rows = []
    for (split, variant, method), members in sorted(groups.items(), key=lambda item: item[0][0] != "train"):
        cells = []
        for metric in METRICS:
            known = [s.values[metric] for s in members if s.values[metric] is not None]
            cells.append(figure(sum(known) / len(known) if known else None, metric))
        rows.append((split, variant, method, str(len(members)), *cells))
    return Table(("split", "variant", "method", "views", *map(title, METRICS)), tuple(rows), 3)


def score_csv(scores: Sequence[Scores]) -> str:
    """All rows at full precision."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["sequence", "variant", "camera", "split", "method", *METRICS])
    for s in scores:
        values = ("" if s.values[m] is None else repr(s.values[m]) for m in METRICS)
        writer.writerow([s.sequence, s.variant, s.camera, s.split, s.method, *values])
    return stream.getvalue()
