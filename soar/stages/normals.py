"""Front and back normal maps of every crop of one training camera: estimated, or the dataset's own."""

from __future__ import annotations

import collections.abc
import dataclasses
from collections.abc import Iterable, Iterator, Mapping
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
from soar.perception.normals import Context, Crop, NormalProvider, encode, normal_provider, sign_test
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
    provider: NormalProvider | None = None
    if "given" in inputs:
        found = _given(inputs, crops)
    else:
        backend = settings(RasterSettings, cfg["raster"], "raster").backend
        posed = _Crops.of(inputs, crops, str(job.camera))
        provider = normal_provider(cfg["normals"], Context(inputs, posed, posed.frames, backend, job.threads))
        found = map(provider.maps, posed)

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
    for remark in provider.remarks if provider else ():
        health.remark(f"Camera {job.camera}: {remark}")
    health.write(outputs["health"])


@dataclasses.dataclass(frozen=True)
class _Crops(collections.abc.Sequence[Crop]):
    """The crops of a camera, each with the body posed in it when it is looked at.

    Attributes:
        model, motion: the body.
        crops: what the stage ``crops`` left.
        frames: number in its recording of each crop's frame.
        size: width and height of the whole stored frame, pixels.
    """

    model: BodyModel
    motion: BodyMotion
    crops: Mapping[str, np.ndarray]
    frames: list[int]
    size: tuple[int, int]

    @staticmethod
    def of(inputs: Mapping[str, Path], crops: Mapping[str, np.ndarray], camera: str) -> _Crops:
        model, motion = BodyModel.load(inputs["body_model"]), BodyMotion.read(inputs["body"])
        sequence = Sequence.read(inputs["sequence"])
        frames = [sequence.frame_ids[frame] for frame in crops["frame_index"]]
        stored = sequence.camera(camera)
        return _Crops(model, motion, crops, frames, (stored.width, stored.height))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, i: int) -> Crop:
        return next(self._posed([range(len(self))[i]]))

    def __iter__(self) -> Iterator[Crop]:
        return self._posed(range(len(self)))

    def _posed(self, chosen: Iterable[int]) -> Iterator[Crop]:
        faces = self.model.faces[~self.model.interior]
        scale, (wide, tall) = float(self.crops["scale"]), self.size
        across, down = wide / round(scale * wide), tall / round(scale * tall)
        for i, vertices, pinhole in posed_in_crops(self.model, self.motion, self.crops, chosen):
            x0, y0, width, height = self.crops["rect"][i] * (across, down, across, down)
            box = (x0, y0, x0 + width, y0 + height)
            rgb, alpha = self.crops["rgb"][i], self.crops["alpha"][i]
            yield Crop(rgb, alpha, vertices, faces, pinhole, self.frames[i], box, self.size)


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
