"""The page of a small made-up dataset."""

from __future__ import annotations

import copy
import csv
import html
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soar.artifacts import write_image, write_json
from soar.health import Health
from soar.report.evaluation import METRICS
from soar.report.video import write_video
from soar.stages import Job, report
from tests.conftest import conf

HOSTILE = "<script>alert('x')</script> & co"


def _figures(start: float) -> dict[str, float | None]:
    values: dict[str, float | None] = {name: round(start + 1.37 * i, 4) for i, name in enumerate(METRICS)}
    return values | {"occluded_mpsnr": None}


METHODS = {"ours": _figures(24.11), "paint": _figures(20.53)}


def write_dataset(folder: Path) -> dict[str, Any]:
    """Two cameras of keypoints, a body without evidence picture, videos and figures; returns the stage's cfg."""
    jobs = []

    def job(stage: str, camera: str | None = None, **files: str) -> dict[str, Path]:
        base = folder / "walk" / "full" / stage
        prefix = f"{camera}." if camera else ""
        named = {"health": f"{prefix}health.json", "evidence": f"{prefix}evidence.jpg"} | files
        paths = {name: base / file for name, file in named.items()} | {"provenance": base / f"{prefix}provenance.json"}
        benchmark = folder / "walk" / "full" / ".jobs" / f"{stage}.{camera or ''}.tsv"
        texts = {name: str(path) for name, path in paths.items()}
        entry = {"sequence": "walk", "variant": "full", "stage": stage, "camera": camera, "files": texts}
        jobs.append(entry | {"benchmark": str(benchmark)})
        models = {"pose.onnx": {"licence": "Apache-2.0", "feeds": "keypoints", "sha256": "ab" * 32}}
        write_json(
            paths["provenance"],
            {"stage": stage, "finished": "2025-03-01T10:00:00+00:00", "models": models, "config": {"note": HOSTILE}},
        )
        benchmark.parent.mkdir(parents=True, exist_ok=True)
        benchmark.write_text("s\th:m:s\tmax_rss\tcpu_time\n12.5\t0:00:12\t431.25\t-\n")
        return paths

    picture = np.random.default_rng(0).integers(0, 255, (60, 90, 3), np.uint8)
    for camera, present in (("cam01", 0.99), ("cam02", 0.42)):
        paths = job("keypoints", camera)
        health = Health("keypoints")
        health.add("present", present)
        health.add("jitter", 0.01234, "torso lengths")
        health.write(paths["health"])
        write_image(paths["evidence"], picture)
    paths = job("body")
    health = Health("body", remarks=[HOSTILE])
    health.add("iou/cam02", 0.85)
    health.add("speed", float("nan"), "m/s")
    health.write(paths["health"])
    paths = job("render", turntable="turntable.webm")
    write_image(paths["evidence"], picture)
    Health("render").write(paths["health"])
    write_video(paths["turntable"], [picture] * 3, 10)
    paths = job("evaluate", metrics="metrics.json", sheet="comparison.jpg", table="per_frame.csv")
    write_image(paths["sheet"], picture)
    write_image(paths["evidence"], picture)
    Health("evaluate").write(paths["health"])
    cameras = {"cam02": {"split": "train", "methods": METHODS}, "cam01": {"split": "eval", "methods": METHODS}}
    settings = {"background": "white", "lpips": "v0.1, alex trunk"}
    write_json(paths["metrics"], {"settings": settings, "cameras": cameras, "bor": {"surfels": 0.2751, "area": 0.4139}})
    node = copy.deepcopy(conf("report", "default"))
    node["limits"] = {"keypoints.present": {"good": 0.98, "bad": 0.8}, "body.iou": {"good": 0.87, "bad": 0.8}}
    node["limits"]["body.speed"] = {"good": 1.0, "bad": 2.0}
    return {"report": node, "jobs": jobs}


def run(folder: Path, cfg: dict[str, Any]) -> tuple[str, str, Path]:
    """Run the stage; returns HTML, Markdown and the CSV's path."""
    out = folder / "report"
    outputs = {"report": out / "report.html", "markdown": out / "report.md", "table": out / "metrics.csv"}
    report.run({}, outputs, cfg, Job("", None, 0, 1, folder / "scratch"))
    return outputs["report"].read_text(), outputs["markdown"].read_text(), outputs["table"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, Path]:
    folder = tmp_path_factory.mktemp("results") / "demo"
    return run(folder, write_dataset(folder))


def text_of(page: str) -> str:
    """What a reader sees."""
    return html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"(?s)<style>.*?</style>", "", page)))


def test_every_figure_is_there(made: tuple[str, str, Path]) -> None:
    page, markdown, table = made
    for text in (text_of(page), markdown):
        for values in METHODS.values():
            for name, value in values.items():
                if value is not None:
                    assert f"{value:.{METRICS[name].digits}f}" in text
        for expected in (
            "0.275",
            "0.414",
            "431.2",
            "Apache-2.0",
            "23.16",
            "Published, other data",
            "alex trunk",
            "62.5",
        ):
            assert expected in text
    rows = list(csv.DictReader(table.open()))
    assert [(r["camera"], r["method"]) for r in rows] == [
        ("cam02", "ours"), ("cam02", "paint"), ("cam01", "ours"), ("cam01", "paint"),
    ]  # fmt: skip
    assert float(rows[0]["psnr"]) == METHODS["ours"]["psnr"]
    assert rows[0]["occluded_mpsnr"] == ""


def test_it_needs_nothing_else(made: tuple[str, str, Path]) -> None:
    page = made[0]
    links = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]+)""", page)
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert page.count("data:video/webm;base64,") == 1
    assert page.count("data:image/jpeg;base64,") == 5
    assert not re.search(r"https?://|//cdn", page)


def test_hostile_text_is_escaped(made: tuple[str, str, Path]) -> None:
    assert "<script" not in made[0]
    assert HOSTILE in text_of(made[0]).replace("\\", "")
    assert "&lt;script&gt;" in made[0]


def test_worst_first(made: tuple[str, str, Path]) -> None:
    health = made[0].split('id="health"')[1].split('id="stages"')[0]
    grades = re.findall(r'<td class="grade (\w+)">', health)
    assert grades == ["bad", "missing", "warn", "ok"]
    names = re.findall(r'<a href="#stage[^"]*">([^<]+)</a></td><td>([^<]+)<', health)
    assert names[0] == ("keypoints.present", "walk / full / cam02")
    assert names[2] == ("body.iou", "walk / full / cam02")


def test_missing_pieces_are_named(made: tuple[str, str, Path]) -> None:
    notice = made[0].split('id="missing"')[1].split("</section>")[0]
    assert re.findall(r"<code>([^<]+)</code>", notice)[-1].endswith("walk/full/body/evidence.jpg")
    assert "body/evidence.jpg" in made[1]
    assert "missing: " in made[0].split('id="stage-walk-full-body"')[1].split("<h3")[0]


def test_stages_come_in_the_order_of_the_dag_with_anchors(made: tuple[str, str, Path]) -> None:
    ids = re.findall(r'<h3 id="(stage-[^"]+)"', made[0])
    assert ids == [f"stage-walk-full-{s}" for s in ("keypoints", "body", "render", "evaluate")]
    anchors = set(re.findall(r'href="#([^"]+)"', made[0]))
    assert anchors <= set(re.findall(r'id="([^"]+)"', made[0]))


def test_what_does_not_fit_is_linked(tmp_path: Path) -> None:
    cfg = write_dataset(tmp_path / "demo")
    cfg["report"]["embed_mb"] = 0.0
    page, _, _ = run(tmp_path / "demo", cfg)
    assert "base64" not in page
    assert 'src="../walk/full/render/turntable.webm"' in page
    assert "not carried in the page" in page
    assert (tmp_path / "demo" / "report" / "../walk/full/render/turntable.webm").exists()


def test_nothing_has_run(tmp_path: Path) -> None:
    cfg = write_dataset(tmp_path / "demo")
    for job in cfg["jobs"]:
        job["files"] = {name: path.replace("/full/", "/gone/") for name, path in job["files"].items()}
        job["benchmark"] = job["benchmark"].replace("/full/", "/gone/")
    page, markdown, _ = run(tmp_path / "demo", cfg)
    assert "No figures" in page
    assert markdown.count("/gone/") == sum(len(set(j["files"]) - {"table"}) for j in cfg["jobs"])


def test_defaults_are_well_formed() -> None:
    from soar.config import settings
    from soar.report.page import ReportSettings

    options = settings(ReportSettings, conf("report", "default"))
    assert set().union(*(row.values for row in options.published.rows)) <= set(METRICS)
    assert options.limits["evaluate.train_iou"].grade(0.947) == "ok"
