"""Landmark names, sides and heatmap refinement."""

from __future__ import annotations

import numpy as np
import pytest

from soar.perception.pose import INDEX, LANDMARKS, MIRROR, refine


def test_names_and_sides():
    assert len(LANDMARKS) == len(set(LANDMARKS)) == 33
    assert (MIRROR[MIRROR] == np.arange(33)).all()
    assert MIRROR[INDEX["nose"]] == INDEX["nose"]
    assert MIRROR[INDEX["mouth_left"]] == INDEX["mouth_right"]
    assert (INDEX["left_wrist"], INDEX["right_hip"], INDEX["right_foot_index"]) == (15, 24, 32)


def _heatmap(peaks: dict[tuple[int, int, int], float]) -> np.ndarray:
    heatmap = np.full((64, 64, 1), -60.0)
    for index, value in peaks.items():
        heatmap[index] = value
    return heatmap


def test_refinement_is_the_weighted_mean_of_cells():
    heatmap = _heatmap({(20, 30, 0): 60.0, (20, 33, 0): 0.0})  # weights 1 and 1/2
    refined = refine(np.array([[31.5 / 64, 20.5 / 64]]), heatmap)
    assert refined[0] == pytest.approx([31 / 64, 20 / 64])


@pytest.mark.parametrize(("away", "reached"), [(4, True), (5, False)])
def test_window_is_nine_cells_wide(away, reached):
    heatmap = _heatmap({(20 + away, 30, 0): 60.0})
    refined = refine(np.array([[30.2 / 64, 20.2 / 64]]), heatmap)[0]
    assert refined == pytest.approx([30 / 64, (20 + away) / 64] if reached else [30.2 / 64, 20.2 / 64])


def test_weak_peaks_and_points_outside_stay():
    points = np.array([[0.5, 0.5]])
    assert np.array_equal(refine(points, _heatmap({(32, 32, 0): -0.1})), points)
    outside = np.array([[1.2, 0.5]])
    assert np.array_equal(refine(outside, np.full((64, 64, 1), 9.0)), outside)


def test_window_is_cut_at_the_border():
    refined = refine(np.array([[0.0, 0.0]]), np.full((64, 64, 1), 60.0))[0]
    assert refined == pytest.approx([2 / 64, 2 / 64])  # cells 0 to 4
