"""One self-contained page for a dataset: figures, footage, and the evidence of every stage.

Its list of jobs comes with the configuration, as ``cfg["jobs"]``, in DAG order. Each has ``sequence``, ``variant``,
``stage``, ``camera`` (or null), ``files`` (output name -> path, relative to the repository) and ``benchmark`` (path of
Snakemake's benchmark table). Of the files it shows ``health``, ``evidence``, ``provenance``, ``metrics``, ``sheet``,
``turntable`` and ``view``; whatever of them a job lists and is not there is shown as missing.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from soar.artifacts import read_json, write_text
from soar.config import settings
from soar.health import Health
from soar.report.ablation import REFINED, SURFACE, ablation
from soar.report.evaluation import METRICS
from soar.report.judge import Number, limit_of, worst_first
from soar.report.page import Carrier, Media, Page, Published, ReportSettings, Section, html, markdown
from soar.report.tables import MISSING, Scores, Table, mean_table, score_csv, score_table, scores_of, title
from soar.report.video import MIME
from soar.stages import Job as StageJob

_MIMES = {".webm": MIME, ".jpg": "image/jpeg", ".png": "image/png"}
_SHOWN = ("health", "evidence", "provenance", "metrics", "sheet", "turntable", "view")


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: StageJob) -> None:
    """Write the page, its tables as Markdown, and all figures as CSV."""
    options = settings(ReportSettings, cfg["report"], "report")
    folder = outputs["report"].parent
    jobs = [_Job(entry) for entry in cfg["jobs"]]
    carrier = Carrier(options.embed_mb * 1e6)
    # The order in which files claim their share of the page: what is looked at first.
    videos = [media for name in ("turntable", "view") for media in _media(jobs, name, "video", carrier, folder)]
    sheets = _media(jobs, "sheet", "image", carrier, folder)
    sections = list(_sections(jobs, options, carrier, folder))
    metrics = [(j, read_json(j.files["metrics"])) for j in jobs if "metrics" in j.present]
    scores = [row for j, value in metrics for row in scores_of(j.sequence, j.variant, value)]
    provenance = [read_json(j.files["provenance"]) for j in jobs if "provenance" in j.present]
    numbers = [number for section in sections for number in section.numbers]
    dataset = folder.parent.name
    page = Page(
        dataset=dataset,
        finished=max((p["finished"] for p in provenance), default="none"),
        means=mean_table(scores) if scores else None,
        scores=score_table(scores) if scores else None,
        protocol=tuple((k, str(v)) for k, v in metrics[0][1]["settings"].items()) if metrics else (),
        published=_published(options.published),
        published_caption=options.published.caption,
        bor=_bor(metrics, options.published),
        ablation=ablation([*scores, *_gaps(jobs)], options.ablation),
        videos=tuple(videos),
        sheets=tuple(sheets),
        judged=tuple(worst_first(numbers)),
        remarks=tuple((s.title, text, s.anchor) for s in sections for text in s.remarks),
        missing=tuple(path for j in jobs for path in j.missing),
        sections=tuple(sections),
        costs=_costs(jobs),
        models=_models(provenance),
        commands=_commands(dataset, sorted({j.variant for j in jobs})),
        decimals=options.decimals,
    )
    write_text(outputs["report"], html(page))
    write_text(outputs["markdown"], markdown(page))
    write_text(outputs["table"], score_csv(scores))


class _Job:
    """One entry of ``cfg["jobs"]`` and which of its files are there."""

    def __init__(self, entry: Mapping[str, Any]) -> None:
        self.sequence, self.variant, self.stage = entry["sequence"], entry["variant"], entry["stage"]
        self.camera: str | None = entry["camera"]
        self.files = {name: Path(path) for name, path in entry["files"].items() if name in _SHOWN}
        self.present = {name for name, path in self.files.items() if path.is_file()}
        self.missing = [str(path) for name, path in self.files.items() if name not in self.present]
        self.benchmark = Path(entry["benchmark"])

    @property
    def place(self) -> str:
        return " / ".join(filter(None, (self.sequence, self.variant, self.camera)))

    @property
    def section(self) -> tuple[str, str, str]:
        return self.sequence, self.variant, self.stage


def _media(jobs: Iterable[_Job], name: str, kind: str, carrier: Carrier, folder: Path) -> list[Media]:
    result = []
    for job in jobs:
        if name in job.files:
            path = job.files[name]
            data = path.read_bytes() if name in job.present else None
            link = os.path.relpath(path, folder) if data is not None else str(path)
            result.append(carrier.carry(kind, f"{job.stage}: {job.place}", data, _MIMES[path.suffix], link))
    return result


def _sections(jobs: Sequence[_Job], options: ReportSettings, carrier: Carrier, folder: Path) -> Iterator[Section]:
    """One section per sequence, variant and stage; the cameras of a per-camera stage share one."""
    for key in dict.fromkeys(job.section for job in jobs):
        members = [job for job in jobs if job.section == key]
        sequence, variant, stage = key
        anchor = "-".join(("stage", sequence, variant, stage))
        numbers: list[Number] = []
        remarks: list[str] = []
        for job in members:
            if "health" in job.present:
                health = Health.read(job.files["health"])
                numbers += _numbers(job, health, options, anchor)
                remarks += [
                    text if job.camera is None or job.camera in text else f"{job.camera}: {text}"
                    for text in health.remarks
                ]
        records = {
            job.camera or stage: read_json(job.files["provenance"]) for job in members if "provenance" in job.present
        }
        yield Section(
            anchor=anchor,
            title=f"{stage}: {sequence} / {variant}",
            media=tuple(_media(members, "evidence", "image", carrier, folder)),
            numbers=tuple(numbers),
            remarks=tuple(remarks),
            missing=tuple(path for job in members for path in job.missing if Path(path) != job.files.get("evidence")),
            provenance=json.dumps(records, indent=1, sort_keys=True, ensure_ascii=False) if records else "",
        )


def _numbers(job: _Job, health: Health, options: ReportSettings, anchor: str) -> Iterator[Number]:
    for name, entry in health.numbers.items():
        base, _, camera = name.partition("/")
        place = f"{job.place} / {camera}" if camera else job.place
        full = f"{health.stage}.{name}" if camera or job.camera is None else f"{health.stage}.{name}/{job.camera}"
        limit = limit_of(full, options.limits)
        yield Number(place, f"{health.stage}.{base}", entry["value"], entry["unit"], limit, anchor)


def _published(published: Published) -> Table:
    """The rows as printed: two decimals for dB, three for the rest."""

    def printed(value: float | None, metric: str) -> str:
        return MISSING if value is None else f"{value:.{2 if METRICS[metric].unit == 'dB' else 3}f}"

    names = [name for name in METRICS if any(name in row.values for row in published.rows)]
    rows = tuple((row.method, *(printed(row.values.get(name), name) for name in names)) for row in published.rows)
    return Table(("method", *map(title, names)), rows, 1)


def _bor(metrics: Sequence[tuple[_Job, Mapping[str, Any]]], published: Published) -> Table:
    ours = [(j.place, f"{m['bor']['surfels']:.3f}", f"{m['bor']['area']:.3f}") for j, m in metrics]
    others = [(f"published: {name}", f"{value:.3f}", MISSING) for name, value in published.bor.items()]
    return Table(("sequence", "per surfel", "area-weighted"), (*ours, *others), 1)


def _gaps(jobs: Iterable[_Job]) -> Iterator[Scores]:
    """The saturation gap of every refined avatar, which the stage that makes it keeps among its health numbers."""
    for job in jobs:
        if job.stage == "refine" and "health" in job.present:
            number = Health.read(job.files["health"]).numbers.get("saturation_gap", {"value": None})
            yield Scores(job.sequence, job.variant, "", SURFACE, REFINED, {"saturation_gap": number["value"]})


def _costs(jobs: Sequence[_Job]) -> Table:
    """Snakemake's own measurement of each job, and their sum."""
    rows, total = [], 0.0
    for job in jobs:
        cost = _benchmark(job.benchmark)
        total += cost.get("s", 0.0)
        cells = (f"{cost[key]:.1f}" if key in cost else MISSING for key in ("s", "cpu_time", "max_rss"))
        rows.append((job.stage, job.place, *cells))
    rows.append(("all jobs", "", f"{total:.1f}", "", ""))
    return Table(("stage", "job", "wall time [s]", "CPU time [s]", "peak memory [MB]"), tuple(rows), 2)


def _benchmark(path: Path) -> dict[str, float]:
    """Numbers of a benchmark table; empty where there is none, without those Snakemake could not take."""
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as stream:
        row = next(csv.DictReader(stream, delimiter="\t"), {})
    result = {}
    for name, text in row.items():
        try:
            result[name] = float(text)
        except ValueError:
            continue
    return result


def _models(provenance: Iterable[Mapping[str, Any]]) -> Table:
    found = {name: facts for record in provenance for name, facts in record["models"].items()}
    rows = (
        (name, str(facts.get("licence", MISSING)), str(facts.get("feeds", MISSING)), str(facts.get("sha256", MISSING)))
        for name, facts in sorted(found.items())
    )
    return Table(("file", "licence", "what for", "sha256"), tuple(rows), 4)


def _commands(dataset: str, variants: Sequence[str]) -> tuple[str, ...]:
    return (
        "make demo          # environment, models, demo capture, this page",
        f"snakemake --config dataset={dataset} 'variants=[{','.join(variants)}]'",
        "# the configuration of every job stands in its provenance above",
    )
