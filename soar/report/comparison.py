"""Sheets that put a photograph and renders side by side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from soar.report.evaluation import Truth
from soar.report.pictures import fit, to_uint8
from soar.report.shots import Shot

BOTH, SURPLUS, LACKING = np.array([0.80, 0.82, 0.85]), np.array([0.90, 0.45, 0.05]), np.array([0.10, 0.35, 0.85])


def comparison(
    title: str, truth: Truth, shots: Mapping[str, Shot], reference: str, height: int
) -> list[tuple[str, np.ndarray]]:
    """One row of the comparison sheet: labelled pictures of photograph, every method, normals and occlusion.

    Args:
        title: of the row's first picture.
        truth: the photograph.
        shots: the same view of each method.
        reference: the method whose normals and occlusion are shown.
        height: of each picture, pixels.
    """
    shown = shots[reference]
    row = [(title, truth.rgb), ("ground truth on white", truth.on_white())]
    row += [(method, shot.on_white()) for method, shot in shots.items()]
    row += [(f"normals of {reference}", shown.normals_on_white()), ("red: never seen", shown.occlusion_on_white())]
    return [(text, _high(picture, height)) for text, picture in row]


def agreement(title: str, truth: Truth, shot: Shot, height: int) -> list[tuple[str, np.ndarray]]:
    """Two labelled pictures of where a render is wrong: its silhouette, and its colours (absolute error times 3)."""
    inside, covered = truth.alpha > 0.5, shot.alpha > 0.5
    silhouette = np.ones((*inside.shape, 3))
    for mask, colour in ((inside & covered, BOTH), (covered & ~inside, SURPLUS), (inside & ~covered, LACKING)):
        silhouette[mask] = colour
    error = 3.0 * np.abs(shot.on_white() - truth.on_white()).mean(-1)
    return [
        (f"{title}: orange too much, blue lacking", _high(silhouette, height)),
        ("colour error x 3", _high(error, height)),
    ]


def _high(picture: np.ndarray, height: int) -> np.ndarray:
    image = to_uint8(picture)
    return fit(image, max(1, round(image.shape[1] * height / image.shape[0])), height)
