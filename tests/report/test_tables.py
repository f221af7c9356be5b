"""The tables of figures on the report: what stands in a cell, which cells stand out, what a mean is over."""

from __future__ import annotations

import csv
import io

import pytest

from soar.report.evaluation import METRICS
from soar.report.tables import MISSING, Scores, Table, figure, mean_table, score_csv, score_table, scores_of, title

WORDS = 5  # columns before the figures: sequence, variant, camera, split, method
PSNR, LPIPS = (WORDS + list(METRICS).index(name) for name in ("psnr", "lpips"))


def row(
    method: str, camera: str = "cam02", split: str = "train", sequence: str = "walk", variant: str = "full",
    **values: float | None,
) -> Scores:  # fmt: skip
    """Figures that are all missing but for ``values``."""
    return Scores(sequence, variant, camera, split, method, dict.fromkeys(METRICS) | values)


def test_markdown_escapes_what_would_break_a_row_and_aligns_numbers_right() -> None:
    table = Table(("name", "a|b"), (("x|y", "1"), ("two\nlines", "22")), 1)
    assert table.markdown().splitlines() == [
        "| name | a\\|b |",
        "| --- | ---: |",
        "| x\\|y | 1 |",
        "| two lines | 22 |",
    ]


def test_a_figure_has_the_digits_of_its_metric_and_a_title_its_unit_and_direction() -> None:
    assert figure(23.456, "psnr") == "23.46"
    assert figure(0.12346, "lpips") == "0.1235"
    assert figure(0.0, "psnr") == "0.00"
    assert figure(None, "psnr") == MISSING
    assert title("psnr") == "PSNR [dB] ↑"
    assert title("lpips") == "LPIPS ↓"


def test_rows_come_training_cameras_first_then_by_name() -> None:
    ours, paint = dict.fromkeys(METRICS, 1.0), dict.fromkeys(METRICS, 2.0)
    cameras = {
        name: {"split": split, "methods": {"ours": ours, "paint": paint}}
        for name, split in (("cam03", "eval"), ("cam04", "train"), ("cam01", "eval"), ("cam02", "train"))
    }
    rows = scores_of("walk", "full", {"cameras": cameras})
    assert [(r.camera, r.split) for r in rows[::2]] == [
        ("cam02", "train"), ("cam04", "train"), ("cam01", "eval"), ("cam03", "eval"),
    ]  # fmt: skip
    assert [r.method for r in rows] == ["ours", "paint"] * 4
    assert {(r.sequence, r.variant) for r in rows} == {("walk", "full")}
    assert (rows[0].values, rows[1].values) == (ours, paint)


def test_every_row_is_named_and_has_every_metric() -> None:
    table = score_table([row("ours", psnr=23.456), row("paint", "cam01", "eval", "run", "dense", lpips=0.5)])
    assert table.head[:WORDS] == ("sequence", "variant", "camera", "split", "method")
    assert table.head[WORDS:] == tuple(map(title, METRICS))
    assert table.text_columns == WORDS
    assert table.rows[0][:WORDS] == ("walk", "full", "cam02", "train", "ours")
    assert table.rows[1][:WORDS] == ("run", "dense", "cam01", "eval", "paint")
    assert (table.rows[0][PSNR], table.rows[0][LPIPS]) == ("23.46", MISSING)
    assert (table.rows[1][PSNR], table.rows[1][LPIPS]) == (MISSING, "0.5000")
    assert {len(cells) for cells in table.rows} == {WORDS + len(METRICS)}


def test_the_best_of_a_camera_stands_out_in_the_metric_s_direction() -> None:
    scores = [
        row("ours", psnr=20.0, lpips=0.3),
        row("paint", psnr=21.0, lpips=0.4),
        row("third", psnr=None, lpips=0.5),
        # Other cameras and sequences do not compete.
        row("ours", "cam01", "eval", psnr=30.0, lpips=0.1),
        row("paint", "cam01", "eval", psnr=29.0, lpips=0.05),
        row("ours", sequence="run", psnr=40.0, lpips=0.01),
        row("paint", sequence="run", psnr=41.0, lpips=0.02),
    ]
    expected = {(1, PSNR), (0, LPIPS), (3, PSNR), (4, LPIPS), (6, PSNR), (5, LPIPS)}
    assert score_table(scores).best == expected


@pytest.mark.parametrize(
    ("values", "best"),
    [
        ((20.0, 20.0), set()),  # nothing to choose
        ((20.001, 20.002), set()),  # nor as far as the table shows
        ((20.0, None), set()),
        ((None, None), set()),
        ((20.0, 21.0, 21.0), {1, 2}),
    ],
    ids=["equal", "rounded", "alone", "none", "shared"],
)
def test_where_methods_agree_nothing_stands_out_and_ties_share(values: tuple, best: set[int]) -> None:
    scores = [row(f"method{i}", psnr=value) for i, value in enumerate(values)]
    assert score_table(scores).best == {(i, PSNR) for i in best}


def test_means_are_over_the_views_of_a_variant_method_and_split_that_were_measured() -> None:
    table = mean_table(
        [
            row("ours", "cam01", "eval", psnr=10.0, lpips=0.1),
            row("ours", psnr=20.0),
            row("paint", psnr=1.0),
            row("ours", "cam03", "eval", psnr=None, lpips=0.2),
            row("ours", "cam01", "eval", "run", psnr=13.0, lpips=0.6),
            row("ours", variant="dense", psnr=99.0),
        ]
    )
    assert table.head == ("split", "variant", "method", "views", *map(title, METRICS))
    assert table.text_columns == 3
    psnr, lpips = PSNR - 1, LPIPS - 1
    assert [(*cells[:4], cells[psnr], cells[lpips]) for cells in table.rows] == [
        ("train", "full", "ours", "1", "20.00", MISSING),
        ("train", "full", "paint", "1", "1.00", MISSING),
        ("train", "dense", "ours", "1", "99.00", MISSING),
        ("eval", "full", "ours", "3", "11.50", "0.3000"),
    ]


def test_csv_keeps_every_digit_and_leaves_the_missing_empty() -> None:
    third = 1 / 3
    text = score_csv([row("ours", psnr=third, lpips=1e-17), row('a "b", c', psnr=0.0)])
    first, second = csv.DictReader(io.StringIO(text))
    assert list(first) == ["sequence", "variant", "camera", "split", "method", *METRICS]
    assert float(first["psnr"]) == third
    assert float(first["lpips"]) == 1e-17
    assert first["ssim"] == ""
    assert second["method"] == 'a "b", c'
    assert float(second["psnr"]) == 0
    assert "\r" not in text
