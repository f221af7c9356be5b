"""Scores of a rendered avatar against the photograph of the same instant."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

import numpy as np

from soar.losses.lpips import Lpips
from soar.metrics.colour import ColourMap
from soar.metrics.image import psnr, ssim
from soar.metrics.masked import iou, lpips_features, mlpips, mpsnr
from soar.report.pictures import composite
from soar.report.shots import Shot

DECIBEL_LIMIT = 100.0
"""dB at which equal images are capped, so that a mean over frames stays finite."""


@dataclasses.dataclass(frozen=True)
class EvaluateSettings:
    """What is measured (``conf/evaluate``)."""

    every: int
    occlusion_threshold: float
    min_pixels: int
    lpips: Literal["alex", "vgg"]
    ssim: Literal["uniform", "gaussian"]
    sheet_frame: float
    sheet_height: int


@dataclasses.dataclass(frozen=True)
class Metric:
    """How one number is named and read."""

    title: str
    unit: str
    higher_is_better: bool
    digits: int


METRICS: dict[str, Metric] = {
    "psnr": Metric("PSNR", "dB", True, 2),
    "ssim": Metric("SSIM", "", True, 3),
    "lpips": Metric("LPIPS", "", False, 4),
    "masked_lpips": Metric("masked LPIPS", "", False, 4),
    "visible_mpsnr": Metric("visible mPSNR", "dB", True, 2),
    "visible_mlpips": Metric("visible mLPIPS", "", False, 4),
    "occluded_mpsnr": Metric("occluded mPSNR", "dB", True, 2),
    "occluded_mlpips": Metric("occluded mLPIPS", "", False, 4),
    "iou": Metric("IoU", "", True, 3),
    "psnr_calibrated": Metric("calibrated PSNR", "dB", True, 2),
    "visible_mpsnr_calibrated": Metric("calibrated visible mPSNR", "dB", True, 2),
    "occluded_mpsnr_calibrated": Metric("calibrated occluded mPSNR", "dB", True, 2),
}
"""Every metric of :func:`score`, in the order of the tables."""


@dataclasses.dataclass(frozen=True)
class Truth:
    """A photograph cut out by its mask: ``rgb`` (H, W, 3) and soft ``alpha`` (H, W), float32 in [0, 1]."""

    rgb: np.ndarray
    alpha: np.ndarray

    @staticmethod
    def of(rgb: np.ndarray, alpha: np.ndarray) -> Truth:
        """From uint8 crops."""
        return Truth(rgb.astype(np.float32) / 255.0, alpha.astype(np.float32) / 255.0)

    def on_white(self) -> np.ndarray:
        """(H, W, 3) float32 picture on white."""
        return composite(self.rgb, self.alpha)


@dataclasses.dataclass(frozen=True)
class Regions:
    """Boolean (H, W) masks in which colours are compared; the same for every method of a frame."""

    visible: np.ndarray
    occluded: np.ndarray

    @property
    def both(self) -> np.ndarray:
        """Either of the two."""
        return self.visible | self.occluded


def regions(truth: Truth, shots: Mapping[str, Shot], reference: str, threshold: float) -> Regions:
    """Split the person's pixels into what training saw and what it never saw.

    A pixel takes part where the ground-truth mask and every method's avatar cover it, so that colours are compared on
    the same pixels for all and silhouettes are left to the IoU. The occlusion map is that of one method.

    Args:
        truth: the photograph.
        shots: the same view of each method.
        reference: the method whose occlusion map decides.
        threshold: tau above which a pixel counts as occluded.
    """
    common = truth.alpha > 0.5
    for shot in shots.values():
        common = common & (shot.alpha > 0.5)
    unseen = shots[reference].occlusion > threshold
    return Regions(common & ~unseen, common & unseen)


def score(
    shots: Mapping[str, Shot],
    truth: Truth,
    parts: Regions,
    colours: Mapping[str, ColourMap],
    lpips: Lpips,
    settings: EvaluateSettings,
) -> dict[str, dict[str, float]]:
    """All :data:`METRICS` of every method's image of one frame.

    Whole-image figures are of the crop on white. Figures of a region compare colours that no background is mixed into,
    since silhouettes are the IoU's business; a region of fewer than ``min_pixels`` pixels has none (NaN).

    Args:
        shots: the rendered avatar of each method.
        truth: the photograph at the same size.
        parts: where colours are compared.
        colours: the map fitted to each method's pixels in this camera.
        lpips: the perceptual distance.
        settings: see :class:`EvaluateSettings`.
    """
    target = truth.on_white()
    large = {
        name: mask.astype(np.float32)
        for name, mask in (("visible", parts.visible), ("occluded", parts.occluded))
        if np.count_nonzero(mask) >= settings.min_pixels
    }
    result = {method: dict.fromkeys(METRICS, math.nan) for method in shots}
    for method, shot in shots.items():
        image, calibrated = shot.on_white(), colours[method](shot.colour)
        result[method] |= {
            "psnr": psnr(image, target),
            "ssim": ssim(image, target, settings.ssim),
            "iou": iou(shot.alpha, truth.alpha),
            "psnr_calibrated": psnr(composite(calibrated, shot.alpha), target),
        }
        for name, mask in large.items():
            result[method][f"{name}_mpsnr"] = mpsnr(shot.colour, truth.rgb, mask)
            result[method][f"{name}_mpsnr_calibrated"] = mpsnr(calibrated, truth.rgb, mask)
    for name, method, value in _perceptual(shots, truth, parts.both, large, lpips):
        result[method][name] = value
    limits = {name: DECIBEL_LIMIT if metric.unit == "dB" else math.inf for name, metric in METRICS.items()}
    return {m: {name: float(min(row[name], limit)) for name, limit in limits.items()} for m, row in result.items()}


def _perceptual(
    shots: Mapping[str, Shot], truth: Truth, both: np.ndarray, large: Mapping[str, np.ndarray], lpips: Lpips
) -> Iterator[tuple[str, str, float]]:
    """Metric, method and value of everything that is LPIPS.

    The network is what evaluation waits for, so it sees each picture of the photograph once for all methods.
    """
    target = lpips_features(truth.on_white(), lpips)
    for method, shot in shots.items():
        yield "lpips", method, float(lpips.distance(lpips_features(shot.on_white(), lpips), target))
    target = lpips_features(truth.rgb, lpips, both)
    for method, shot in shots.items():
        yield "masked_lpips", method, float(lpips.distance(lpips_features(shot.colour, lpips, both), target))
    for name, mask in large.items():
        target = lpips_features(truth.rgb, lpips, mask)
        for method, shot in shots.items():
            yield f"{name}_mlpips", method, mlpips(lpips_features(shot.colour, lpips, mask), target, mask, lpips)


def means(rows: Iterable[Mapping[str, float]]) -> dict[str, float | None]:
    """Mean of every metric over the frames that have it; None where none has."""
    table = list(rows)
    result: dict[str, float | None] = {}
    for name in METRICS:
        values = [row[name] for row in table if not math.isnan(row[name])]
        result[name] = sum(values) / len(values) if values else None
    return result
