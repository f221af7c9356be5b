"""Scores with known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from soar.config import settings
from soar.losses.lpips import Lpips
from soar.metrics.colour import ColourMap
from soar.report.evaluation import DECIBEL_LIMIT, METRICS, EvaluateSettings, Truth, means, regions, score
from soar.report.footage import crack_share, thinned
from soar.report.shots import Shot
from tests.conftest import conf
from tests.report.toy import lpips_file

SIZE = 48
OPTIONS = settings(EvaluateSettings, conf("evaluate", "default"))
IDENTITY = ColourMap(np.ones(3), np.zeros(3))


@pytest.fixture(scope="module")
def lpips(tmp_path_factory: pytest.TempPathFactory) -> Lpips:
    path = tmp_path_factory.mktemp("lpips") / "lpips_alex.safetensors"
    lpips_file(path)
    return Lpips.load(path, "alex")


@pytest.fixture
def truth() -> Truth:
    """A square person of noise."""
    alpha = np.zeros((SIZE, SIZE), np.float32)
    alpha[8:40, 12:36] = 1
    return Truth(np.random.default_rng(0).random((SIZE, SIZE, 3), np.float32), alpha)


def shot(truth: Truth, tau: float = 0.0, shift: int = 0, add: float = 0.0) -> Shot:
    """The truth as an avatar: right half occluded by ``tau``, moved by ``shift`` pixels, brightened by ``add``."""
    occlusion = np.zeros_like(truth.alpha)
    occlusion[:, SIZE // 2 :] = tau
    normal = np.zeros((SIZE, SIZE, 3), np.float32)
    colour = np.clip(truth.rgb + add, 0, 1)
    return Shot(np.roll(colour, shift, 1), np.roll(truth.alpha, shift, 1), normal, occlusion)


def scores_of(mine: Shot, truth: Truth, lpips: Lpips) -> dict[str, float]:
    """The figures of one method alone."""
    shots = {"ours": mine}
    return score(shots, truth, regions(truth, shots, "ours", 0.5), {"ours": IDENTITY}, lpips, OPTIONS)["ours"]


def test_equal_images_are_capped_not_infinite(truth: Truth, lpips: Lpips) -> None:
    mine = shot(truth, tau=1.0)
    scores = scores_of(mine, truth, lpips)
    assert list(scores) == list(METRICS)
    for name in ("psnr", "visible_mpsnr", "occluded_mpsnr", "psnr_calibrated"):
        assert scores[name] == DECIBEL_LIMIT
    assert scores["iou"] == 1
    assert scores["ssim"] == pytest.approx(1)
    for name in ("lpips", "visible_mlpips", "occluded_mlpips"):
        assert scores[name] == pytest.approx(0, abs=1e-6)


def test_a_known_error(lpips: Lpips) -> None:
    alpha = np.zeros((SIZE, SIZE), np.float32)
    alpha[:, : SIZE // 2] = 1
    flat = Truth(np.full((SIZE, SIZE, 3), 0.5, np.float32), alpha)
    mine = shot(flat, add=0.1)
    scores = scores_of(mine, flat, lpips)
    assert scores["visible_mpsnr"] == pytest.approx(20, abs=1e-4)
    assert scores["psnr"] == pytest.approx(20 + 10 * math.log10(2), abs=1e-4)  # half of the crop is white
    assert math.isnan(scores["occluded_mpsnr"])


def test_a_shift_lowers_the_overlap(truth: Truth, lpips: Lpips) -> None:
    mine = shot(truth, shift=6)
    scores = scores_of(mine, truth, lpips)
    assert scores["iou"] == pytest.approx(18 / 30)
    assert scores["psnr"] < 20


def test_methods_share_the_photograph_and_nothing_else(
    truth: Truth, lpips: Lpips, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit what each method scores without the others; the photograph passes the trunk once per picture."""
    shots = {"ours": shot(truth, tau=1.0, add=0.1), "paint": shot(truth, shift=2), "third": shot(truth, add=-0.2)}
    parts = regions(truth, shots, "ours", 0.5)
    colours = {m: ColourMap(np.full(3, gain), np.zeros(3)) for m, gain in zip(shots, (1.0, 0.9, 1.2), strict=True)}
    alone = {m: score({m: s}, truth, parts, colours, lpips, OPTIONS)[m] for m, s in shots.items()}
    assert not any(math.isnan(value) for row in alone.values() for value in row.values())
    passes, trunk = [], lpips.features
    monkeypatch.setattr(lpips, "features", lambda images: passes.append(len(images)) or trunk(images))
    assert score(shots, truth, parts, colours, lpips, OPTIONS) == alone
    pictures = 4  # whole, both regions, visible, occluded
    assert sum(passes) == pictures * (1 + len(shots))


def test_perceptual_figures_are_the_distance_of_their_pictures(truth: Truth, lpips: Lpips) -> None:
    mine = shot(truth, tau=1.0, add=0.1)
    scores = scores_of(mine, truth, lpips)
    person = truth.alpha > 0.5

    def planes(image: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(image).permute(2, 0, 1)[None].contiguous()

    assert scores["lpips"] == float(lpips(planes(mine.on_white()), planes(truth.on_white())))
    inside = [planes(np.where(person[..., None], image, np.float32(0))) for image in (mine.colour, truth.rgb)]
    assert scores["masked_lpips"] == float(lpips(*inside))
    seen = torch.from_numpy(person & (mine.occlusion == 0))
    a, b = (lpips.features(picture * seen) for picture in inside)
    spread = lpips.spatial(a, b, truth.alpha.shape)[0, 0]
    assert scores["visible_mlpips"] == pytest.approx(float(spread[seen].mean()), rel=1e-5)


def test_regions_are_common_to_all_methods_and_split_by_tau(truth: Truth) -> None:
    parts = regions(truth, {"ours": shot(truth, tau=0.6), "paint": shot(truth, shift=6)}, "ours", 0.5)
    common = (truth.alpha > 0.5) & (np.roll(truth.alpha, 6, 1) > 0.5)
    assert (parts.both == common).all()
    assert not (parts.visible & parts.occluded).any()
    assert parts.occluded[:, SIZE // 2 :].sum() == parts.occluded.sum() > 0
    seen = regions(truth, {"ours": shot(truth, tau=0.5)}, "ours", 0.5)
    assert not seen.occluded.any()  # the threshold itself still counts as visible


def test_means_leave_out_what_was_not_measured() -> None:
    row = dict.fromkeys(METRICS, 1.0)
    result = means([row | {"psnr": 3.0, "iou": math.nan}, row | {"iou": math.nan}])
    assert result["psnr"] == 2.0
    assert result["iou"] is None
    assert means([])["psnr"] is None


def test_cracks_are_narrow_gaps() -> None:
    alpha = np.zeros((60, 60), np.float32)
    alpha[:, 10:50] = 1
    blank = np.zeros((60, 60, 3), np.float32)
    assert crack_share(Shot(blank, alpha, blank, alpha)) == 0
    alpha[30, 20:40] = 0.2
    assert crack_share(Shot(blank, alpha, blank, alpha)) == pytest.approx(20 / 2380)
    alpha[20:40, 20:40] = 0  # as wide as a gap between limbs
    assert crack_share(Shot(blank, alpha, blank, alpha)) < 0.005


@pytest.mark.parametrize(("count", "most", "step", "kept"), [(4, 300, 1, 4), (301, 300, 2, 151), (10, 3, 4, 3)])
def test_thinning(count: int, most: int, step: int, kept: int) -> None:
    assert (thinned(count, most).step, len(thinned(count, most))) == (step, kept)
