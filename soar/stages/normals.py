"""Front and back normal maps of every crop of one training camera: estimated, or the dataset's own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import read_npz, write_image, write_npz
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.config import settings
from soar.datasets.planes import cropped_normals
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.perception.normals import NormalProvider, encode, normal_provider, sign_test
from soar.progress import track
from soar.raster import RasterSettings
from soar.report.pictures import colour_normals, composite, grid, spread
from soar.stages import Job
from soar.stages._posed import posed_in_crops
from soar.stages._subject import archive

_SHOWN = 4  # frames on the evidence sheet


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the maps of ``job.camera``, a sheet of some frames, and health."""
    crops = read_npz(inputs["crops"])
    count, height, width = crops["alpha"].shape
    if "given" in inputs:
        found = _given(inputs, crops)
    else:
        provider = normal_provider(cfg["normals"], settings(RasterSettings, cfg["raster"], "raster"), job.threads)
        found = _estimated(provider, BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"]), crops)

    maps = {side: np.zeros((count, height, width, 3), np.int8) for side in ("front", "back")}
    overlaps, failed = [], []
    for i, (front, back) in enumerate(track(found, f"normals {job.camera}", count)):
        maps["front"][i], maps["back"][i] = encode(front), encode(back)
        if not sign_test(front, back).passed:
            failed.append(i)
        overlaps.append(_overlap(np.abs(front).max(-1) > 0, crops["alpha"][i] > 127))

    write_npz(outputs["normals"], maps, compress=True)
    shown = spread(count, _SHOWN)
    pictures = [
        picture
        for i in shown
        for picture in (
            composite(crops["rgb"][i], crops["alpha"][i]),
            colour_normals(maps["front"][i]),
            colour_normals(maps["back"][i]),
        )
    ]
    labels = [f"{job.camera}  {what} {i + 1} of {count}" for i in shown for what in ("crop", "front", "back")]
    write_image(outputs["evidence"], grid(pictures, 6, labels))

    health = Health("normals")
    health.add("coverage_iou", float(np.mean(overlaps)))
    health.add("coverage_iou_min", float(np.min(overlaps)))
    health.add("sign_test_failed", len(failed) / count)
    if failed:
        health.remark(
            f"Camera {job.camera}: in {len(failed)} of {count} crops the normals fail the sign test (first: crop "
            f"{failed[0] + 1}); the body is out of the picture there, or the maps are in another convention."
        )
    health.write(outputs["health"])


def _estimated(
    provider: NormalProvider, model: BodyModel, motion: BodyMotion, crops: Mapping[str, np.ndarray]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Front and back normals (H, W, 3) float32 of every crop, from its picture and the posed body."""
    faces = model.faces[~model.interior]
    for i, vertices, pinhole in posed_in_crops(model, motion, crops, range(len(crops["rgb"]))):
        yield provider.maps(crops["rgb"][i], crops["alpha"][i], vertices, faces, pinhole)


def _given(inputs: Mapping[str, Path], crops: Mapping[str, np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The dataset's own maps, cut as the crops were."""
    frames = len(Sequence.read(inputs["sequence"]))
    planes = [archive(inputs["given"], frames, side) for side in ("front", "back")]
    scale = float(crops["scale"])
    for frame, rect in zip(crops["frame_index"].tolist(), crops["rect"], strict=True):
        front, back = (cropped_normals(plane[frame], scale, rect) for plane in planes)
        yield front, back


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks; 0 where both are empty."""
    return float((a & b).sum() / max((a | b).sum(), 1))
