"""The ablation table, its verdicts, and the section of the page."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from soar.artifacts import write_json
from soar.config import settings
from soar.errors import ConfigError
from soar.health import Health
from soar.report.ablation import REFINED, SURFACE, Ablation, AblationSettings, ablation
from soar.report.evaluation import METRICS
from soar.report.tables import MISSING, Scores
from tests.conftest import conf
from tests.stages.test_report import run, text_of, write_dataset

NODE = conf("report", "default")["ablation"]
HEAD = ("occluded mPSNR [dB] ↑", "training: visible mPSNR [dB] ↑", "saturation gap ↓")


def scores(variant: str, value: float, method: str = REFINED, sequence: str = "walk", cameras: int = 1) -> list[Scores]:
    """One training camera with ``value`` everywhere, evaluation cameras with ``value`` + 0, 1, 2 ..."""
    names = [("train", 0.0), *(("eval", float(i)) for i in range(cameras))]
    return [
        Scores(sequence, variant, f"{split}{i:g}", split, method, dict.fromkeys(METRICS, value + i))
        for split, i in names
    ]


def expecting(**expectation: Any) -> AblationSettings:
    """The rows of the default and one expectation: full above no_sds unless told otherwise."""
    default = {"left": "full", "right": "no_sds", "metric": "occluded_mpsnr", "direction": "above"}
    default |= {"margin": 2.0, "source": "ours", "why": "The prior was asleep."}
    return settings(AblationSettings, NODE | {"expectations": [default | expectation]})


def made(rows: list[Scores], options: AblationSettings | None = None) -> Ablation:
    result = ablation(rows, options or settings(AblationSettings, NODE))
    assert result is not None
    return result


def column(section: Ablation, head: str) -> dict[str, str]:
    index = section.table.head.index(head)
    return {row[0]: row[index] for row in section.table.rows}


def test_the_mean_is_over_cameras_then_over_sequences() -> None:
    rows = [*scores("full", 10.0), *scores("full", 20.0, sequence="run", cameras=3), *scores("direct", 12.0)]
    section = made(rows)
    assert column(section, HEAD[0]) == {"full": "15.50", "direct": "12.00"}  # (10 + (20 + 21 + 22) / 3) / 2
    assert column(section, HEAD[1]) == {"full": "15.00", "direct": "12.00"}
    assert column(section, "sequences") == {"full": "2", "direct": "1"}
    assert "sequence" in section.note


def test_a_sequence_without_the_figure_is_left_out() -> None:
    empty = [Scores("run", "full", "a", "eval", REFINED, dict.fromkeys(METRICS))]
    section = made([*scores("full", 10.0), *empty, *scores("direct", 12.0)])
    assert column(section, HEAD[0])["full"] == "10.00"
    assert column(section, HEAD[2]) == {"full": MISSING, "direct": MISSING}


def test_rows_come_in_the_configured_order_and_unknown_variants_last() -> None:
    variants = ("mine", "full", "dense", "occ_sds", "no_implicit", "direct", "no_sds")
    others = [row for method in ("unrefined", "paint") for row in scores("full", 1.0, method)]
    section = made([row for v in variants for row in [*scores(v, 5.0), *scores(v, 9.0, "paint")]] + others)
    names = [row[0] for row in section.table.rows]
    assert names == ["paint", "unrefined", "no_sds", "direct", "no_implicit", "occ_sds", "full", "dense", "mine"]
    meanings = {row[0]: row[1] for row in section.table.rows}
    assert meanings["mine"] == MISSING
    assert all(meaning != MISSING for name, meaning in meanings.items() if name != "mine")


def test_paint_and_unrefined_are_those_of_full() -> None:
    rows = [r for v, value in (("full", 8.0), ("no_sds", 3.0)) for m in ("paint", "ours") for r in scores(v, value, m)]
    assert column(made(rows), HEAD[0]) == {"paint": "8.00", "no_sds": "3.00", "full": "8.00"}


def test_one_variant_is_no_ablation() -> None:
    assert ablation([], settings(AblationSettings, NODE)) is None
    assert ablation([*scores("full", 1.0), *scores("full", 1.0, "paint")], settings(AblationSettings, NODE)) is None


@pytest.mark.parametrize(
    ("expectation", "full", "holds", "claim"),
    [
        ({}, 12.0, True, "occluded mPSNR of full at least 2 dB above no_sds"),
        ({}, 11.9, False, "occluded mPSNR of full at least 2 dB above no_sds"),
        ({"margin": 0.0}, 10.0, False, "occluded mPSNR of full above no_sds"),
        ({"margin": 0.0}, 10.1, True, "occluded mPSNR of full above no_sds"),
        ({"direction": "below", "margin": 0.0}, 9.9, True, "occluded mPSNR of full below no_sds"),
        ({"direction": "below", "margin": 0.0}, 10.1, False, "occluded mPSNR of full below no_sds"),
        ({"margin": -0.5}, 9.5, True, "occluded mPSNR of full at most 0.5 dB below no_sds"),
        ({"margin": -0.5}, 9.4, False, "occluded mPSNR of full at most 0.5 dB below no_sds"),
        ({"direction": "below", "margin": -0.5}, 10.5, True, "occluded mPSNR of full at most 0.5 dB above no_sds"),
        ({"direction": "near", "margin": 0.5}, 9.5, True, "occluded mPSNR of full within 0.5 dB of no_sds"),
        ({"direction": "near", "margin": 0.5}, 10.6, False, "occluded mPSNR of full within 0.5 dB of no_sds"),
        ({"right": 11, "margin": 0.0, "metric": "psnr"}, 11.5, True, "PSNR of full above 11"),
        ({"margin": 0.0, "metric": "visible_mpsnr"}, 9.5, False, "training: visible mPSNR of full above no_sds"),
    ],
)  # fmt: skip
def test_verdicts(expectation: dict[str, Any], full: float, holds: bool, claim: str) -> None:
    (verdict,) = made([*scores("full", full), *scores("no_sds", 10.0)], expecting(**expectation)).verdicts
    values = f"full {full:.2f}" + ("" if "right" in expectation else ", no_sds 10.00")
    why = "" if holds else " The prior was asleep."
    assert verdict.holds is holds
    assert verdict.words == ("holds" if holds else "does not hold")
    assert verdict.text == f"{claim} (our own aim): {values}.{why}"


def test_no_reason_is_shown_where_none_is_known() -> None:
    (verdict,) = made([*scores("full", 1.0), *scores("no_sds", 2.0)], expecting(why=None, source="paper")).verdicts
    assert verdict.text.endswith("(as in the paper): full 1.00, no_sds 2.00.")


def test_a_missing_variant_is_said_and_not_judged() -> None:
    (verdict,) = made([*scores("full", 1.0), *scores("dense", 2.0)], expecting()).verdicts
    assert (verdict.holds, verdict.words) == (None, "not measured")
    assert verdict.text.endswith(f"full 1.00, no_sds {MISSING}.")


@pytest.mark.parametrize("wrong", [{"metric": "beauty"}, {"direction": "near", "margin": -1.0}])
def test_what_cannot_be_judged_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"report\.ablation"):
        expecting(**wrong)


def test_expectations_of_the_default_speak_of_its_rows() -> None:
    options = settings(AblationSettings, NODE)
    names = {row.name for row in options.rows}
    assert len(names) == len(options.rows)
    for expectation in options.expectations:
        assert expectation.left in names
        assert expectation.right in names or isinstance(expectation.right, float)


def test_the_surface_has_no_camera() -> None:
    gap = Scores("walk", "full", "", SURFACE, REFINED, {"saturation_gap": 0.1234})
    section = made([*scores("full", 1.0), gap, *scores("no_sds", 1.0)])
    assert column(section, HEAD[2]) == {"full": "0.123", "no_sds": MISSING}
    assert column(section, HEAD[0])["full"] == "1.00"


def test_page_and_markdown_have_the_section(tmp_path: Path) -> None:
    cfg = write_dataset(tmp_path / "demo")
    page, markdown, _ = run(tmp_path / "demo", copy.deepcopy(cfg))
    assert "ablation" not in page.lower().replace("(ablation table)", "")
    assert "## Ablation" not in markdown

    full = next(job for job in cfg["jobs"] if job["stage"] == "evaluate")
    files = {name: path.replace("/full/", "/no_sds/") for name, path in full["files"].items()}
    other = {"split": "eval", "methods": {REFINED: dict.fromkeys(METRICS, 7.0)}}
    write_json(files["metrics"], {"settings": {}, "cameras": {"cam01": other}, "bor": {"surfels": 0.3, "area": 0.4}})
    health = Health("refine")
    health.add("saturation_gap", 0.31)
    path = tmp_path / "demo" / "walk" / "full" / "refine" / "health.json"
    health.write(path)
    cfg["jobs"] += [full | {"variant": "no_sds", "files": files}]
    cfg["jobs"] += [full | {"stage": "refine", "files": {"health": str(path)}}]
    page, markdown, _ = run(tmp_path / "demo", cfg)
    text = " ".join(text_of(page.split('<h2 id="ablation">')[1].split("<h2")[0]).split())
    table = markdown.split("## Ablation\n")[1].split("\n## ")[0]
    assert 'href="#ablation"' in page
    assert "| no_sds | w/o SDS: from grey, without the prior | 1 | 7.00 |" in table
    assert "no_sds w/o SDS: from grey, without the prior 1 7.00" in text
    for part in (text, table):
        assert "over sequences" in part
        assert "saturation gap of full within 0.2 of 0 (our own aim): full 0.310." in part
        assert f"full {MISSING}, no_sds 7.00." in part
    assert "\n- does not hold: saturation gap of full" in table
    assert '<span class="grade bad">does not hold</span>: saturation gap of full' in page
    assert '<span class="grade missing">not measured</span>: occluded mPSNR of full' in page
