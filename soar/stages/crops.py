"""Cut the person out of one camera's frames at working resolution."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import ImageArchive, write_image, write_npz
from soar.config import settings
from soar.datasets.crops import CropSettings, Windows, border_share, cut, find_windows
from soar.datasets.ingest import limited, resample
from soar.datasets.sequence import Sequence, read_calibrated
from soar.errors import ArtifactError
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.progress import track
from soar.report.pictures import composite, grid, overlay_mask, spread
from soar.stages import Job

_SHOWN = 6  # crops on the evidence sheet


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the crops of ``job.camera`` with the refined camera, their health and a sheet of six.

    Images are filled on disk, so memory does not grow with the clip.
    """
    options = settings(CropSettings, cfg["crops"], "crops")
    sequence, camera = Sequence.read(inputs["sequence"]), read_calibrated(inputs["calibration"], job.camera)
    frames, masks = ImageArchive(inputs["frames"]), ImageArchive(inputs["masks"])
    _check(sequence, camera, frames, masks)
    working = limited(camera, options.long_side)
    windows = find_windows(track(masks, f"windows {camera.name}", len(masks)), working, options)
    job.scratch.mkdir(parents=True, exist_ok=True)
    rgb, alpha = _fill(frames, masks, working, windows, job.scratch)
    arrays = {
        "rgb": rgb,
        "alpha": alpha,
        "K": np.stack([windows.camera(working, i).K for i in range(len(rgb))]),
        "T_cam_from_world": camera.T_cam_from_world,
        "rect": windows.rect,
        "scale": np.float64(working.width / camera.width),
        "frame_index": windows.frame_index,
    }
    write_npz(outputs["crops"], arrays)
    shown = spread(len(rgb), _SHOWN)
    pictures = [overlay_mask(composite(rgb[i], alpha[i]), alpha[i], opacity=0.0) for i in shown]
    labels = [f"{camera.name}  frame {sequence.frame_ids[windows.frame_index[i]]}" for i in shown]
    write_image(outputs["evidence"], grid(pictures, len(pictures), labels))
    _health(windows, working, alpha).write(outputs["health"])


def _fill(
    frames: ImageArchive, masks: ImageArchive, working: Camera, windows: Windows, folder: Path
) -> tuple[np.ndarray, np.ndarray]:
    """(T, H, W, 3) and (T, H, W) uint8 crops, mapped to files in ``folder``."""
    width, height = map(int, windows.rect[0, 2:])
    shape, size = (len(windows.rect), height, width), (working.width, working.height)
    rgb = np.lib.format.open_memmap(folder / "rgb.npy", "w+", np.uint8, (*shape, 3))
    alpha = np.lib.format.open_memmap(folder / "alpha.npy", "w+", np.uint8, shape)
    for i, index in enumerate(track(windows.frame_index, f"crops {working.name}", len(rgb))):
        rgb[i] = cut(resample(frames[index], *size), windows.rect[i])
        alpha[i] = cut(resample(masks[index], *size), windows.rect[i])
    return rgb, alpha


def _health(windows: Windows, working: Camera, alpha: np.ndarray) -> Health:
    health, shown, empty = Health("crops"), len(windows.rect), windows.frames - len(windows.rect)
    width, height = map(int, windows.rect[0, 2:])
    health.add("width", width, "px")
    health.add("height", height, "px")
    health.add("empty_frames", empty / windows.frames)
    health.add("cut_off_frames", windows.cut_off / shown)
    health.add("border_share", border_share(alpha))
    if empty:
        health.remark(f"Camera {working.name}: {empty} of {windows.frames} frames show nobody and are left out.")
    if windows.cut_off:
        health.remark(
            f"Camera {working.name}: the image's border cuts the person in {windows.cut_off} of {shown} frames."
        )
    return health


def _check(sequence: Sequence, camera: Camera, frames: ImageArchive, masks: ImageArchive) -> None:
    stored = sequence.camera(camera.name)
    shapes = {"frames": (frames, (stored.height, stored.width, 3)), "masks": (masks, (stored.height, stored.width))}
    for name, (archive, shape) in shapes.items():
        if len(archive) != len(sequence) or archive[0].shape != shape:
            raise ArtifactError(
                f"camera {camera.name}: {name} do not fit the sequence",
                expected=f"{len(sequence)} images of {shape}",
                got=f"{len(archive)} images of {archive[0].shape if len(archive) else None}",
                cure=f"delete {archive.path} and run snakemake; it is made again",
            )
    if (camera.width, camera.height) != (stored.width, stored.height):
        raise ArtifactError(f"camera {camera.name}: the refined camera has another size than the frames")
