"""Measure the avatar, and beside it what it was before the refinement and the unoptimised baseline, in every camera."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import read_npz, write_image, write_json, write_text
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.losses.lpips import Lpips
from soar.metrics.bor import body_occlusion_ratio
from soar.metrics.colour import ColourMap, calibrate
from soar.optimise.views import Views
from soar.progress import track
from soar.report.comparison import agreement, comparison
from soar.report.evaluation import METRICS, EvaluateSettings, Regions, Truth, means, regions, score
from soar.report.pictures import grid
from soar.report.shots import Shot
from soar.stages import Job
from soar.stages._rig import Rig

_OURS = "ours"


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the means per camera, the table of frames, the comparison sheet, evidence and health."""
    options = settings(EvaluateSettings, cfg["evaluate"], "evaluate")
    sequence = Sequence.read(inputs["sequence"])
    rig = Rig.read(inputs, cfg)
    places = {_OURS: "avatar", "unrefined": "unrefined", "paint": "paint"}
    puppets = {method: rig.puppet(Avatar.read(inputs[name])) for method, name in places.items()}
    lpips = Lpips.load(inputs["models"] / f"lpips_{options.lpips}.safetensors", options.lpips)
    cameras: dict[str, Any] = {}
    table: list[dict[str, Any]] = []
    sheet: list[tuple[str, np.ndarray]] = []
    evidence: list[tuple[str, np.ndarray]] = []
    for name in sequence.names:
        split = "train" if name in sequence.train else "eval"
        camera = _Camera(Views.of(name, read_npz(inputs["crops"] / f"{name}.npz")), puppets, options)
        rows = [
            {"camera": name, "split": split, "frame": sequence.frame_ids[frame], "method": method} | scores
            for frame, method, scores in camera.scores(lpips)
        ]
        table += rows
        cameras[name] = {
            "split": split,
            "crop": list(camera.views.size[::-1]),
            "frames": len(camera.indices),
            "methods": {m: means(row for row in rows if row["method"] == m) for m in camera.puppets},
            "colour": {m: {"gain": c.gain, "offset": c.offset} for m, c in camera.colours.items()},
        }
        truth, shots, _ = camera.look(camera.indices[round(options.sheet_frame * (len(camera.indices) - 1))])
        sheet += comparison(f"{name} ({split})", truth, shots, _OURS, options.sheet_height)
        evidence += agreement(f"{name} ({split})", truth, shots[_OURS], options.sheet_height)
    ours = puppets[_OURS].avatar
    bor, bor_area = body_occlusion_ratio(ours.occlusion, ours.scales)
    metrics = {"settings": _protocol(options), "cameras": cameras, "bor": {"surfels": bor, "area": bor_area}}
    write_json(outputs["metrics"], metrics)
    write_text(outputs["table"], _csv(table))
    write_image(outputs["sheet"], grid([p for _, p in sheet], len(sheet) // len(cameras), [t for t, _ in sheet]))
    write_image(outputs["evidence"], grid([p for _, p in evidence], 4, [t for t, _ in evidence]))
    _health(cameras, bor, bor_area).write(outputs["health"])


class _Camera:
    """One camera's crops seen beside every method's renders, one frame in memory at a time."""

    def __init__(self, views: Views, puppets: Mapping[str, Puppet], options: EvaluateSettings) -> None:
        self.views, self.puppets, self.options = views, puppets, options
        self.indices = range(0, len(views), options.every)
        self.colours = self._calibrate()

    def look(self, index: int) -> tuple[Truth, dict[str, Shot], Regions]:
        truth = Truth.of(self.views.rgb[index], self.views.alpha[index])
        shots = {method: Shot.beside(self.views, index, puppet) for method, puppet in self.puppets.items()}
        return truth, shots, regions(truth, shots, _OURS, self.options.occlusion_threshold)

    def scores(self, lpips: Lpips) -> Iterator[tuple[int, str, dict[str, float]]]:
        """Frame position in the clip, method, and its scores."""
        for index in track(self.indices, f"evaluate {self.views.camera}", len(self.indices)):
            truth, shots, parts = self.look(index)
            for method, scores in score(shots, truth, parts, self.colours, lpips, self.options).items():
                yield int(self.views.frames[index]), method, scores

    def _calibrate(self) -> dict[str, ColourMap]:
        """Rendering again for the scores is cheaper than keeping the pictures of a long clip."""
        pixels: dict[str, list[np.ndarray]] = {method: [] for method in self.puppets}
        targets: list[np.ndarray] = []
        for index in self.indices:
            truth, shots, parts = self.look(index)
            targets.append(truth.rgb[parts.both])
            for method, shot in shots.items():
                pixels[method].append(shot.colour[parts.both])
        return {method: calibrate(np.concatenate(seen), np.concatenate(targets)) for method, seen in pixels.items()}


def _protocol(options: EvaluateSettings) -> dict[str, Any]:
    """What a reader must know before comparing these figures with any others."""
    return {
        "background": "white",
        "image": "the crop around the person at working resolution; size per camera",
        "frames": f"every {options.every}th crop, means of per-frame figures",
        "region": "ground-truth mask and every method's avatar above one half, the same pixels for every "
        "method; colours without the background",
        "visible": f"rendered tau of the avatar at most {options.occlusion_threshold}",
        "occluded": f"rendered tau of the avatar above {options.occlusion_threshold}",
        "min_pixels": options.min_pixels,
        "lpips": f"v0.1, {options.lpips} trunk; masked LPIPS: both images black outside the region; mLPIPS: the same, "
        "spatial map averaged in the mask",
        "ssim": options.ssim,
        "calibrated": "after gain and offset per channel fitted on the compared pixels of the camera, per method",
    }


def _csv(rows: list[dict[str, Any]]) -> str:
    stream = io.StringIO()
    writer = csv.DictWriter(stream, ["camera", "split", "frame", "method", *METRICS], lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: "" if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()})
    return stream.getvalue()


def _health(cameras: Mapping[str, Any], bor: float, bor_area: float) -> Health:
    health = Health("evaluate")
    for name, camera in cameras.items():
        ours, paint = camera["methods"][_OURS], camera["methods"]["paint"]
        for metric in ("iou", "psnr", "masked_lpips"):
            unit = METRICS[metric].unit
            health.add(f"{camera['split']}_{metric}/{name}", _number(ours[metric]), unit)
            gain = (_number(ours[metric]) - _number(paint[metric])) * (1 if METRICS[metric].higher_is_better else -1)
            health.add(f"{camera['split']}_{metric}_gain/{name}", gain, unit)
    health.add("bor", bor)
    health.add("bor_area", bor_area)
    return health


def _number(value: float | None) -> float:
    return math.nan if value is None else value
