"""Undistort one camera's frames and store them, measured on the way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import write_image, write_images
from soar.datasets import adapter
from soar.datasets.ingest import stored_frames
from soar.datasets.quality import FrameQuality
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.progress import track
from soar.report.pictures import fit, grid
from soar.stages import Job


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the frames of ``job.camera``, their health and a sheet of the first, middle and last one."""
    sequence = Sequence.read(inputs["sequence"])
    capture = adapter(cfg["dataset"]).capture(job.sequence)
    camera, shown = sequence.camera(job.camera), sorted({0, len(sequence) // 2, len(sequence) - 1})
    quality, pictures = FrameQuality(), []

    def observed() -> Iterator[np.ndarray]:
        images = stored_frames(capture, sequence, camera.name)
        for index, image in enumerate(track(images, f"frames {camera.name}", len(sequence))):
            quality.add(image)
            if index in shown:
                pictures.append(fit(image, 480, round(480 * camera.height / camera.width)))
            yield image

    write_images(outputs["frames"], observed(), ".jpg", capture.frames.jpeg_quality)
    labels = [f"{camera.name}  frame {sequence.frame_ids[i]}  ({i + 1} of {len(sequence)})" for i in shown]
    write_image(outputs["evidence"], grid(pictures, len(pictures), labels))
    health = Health("frames")
    health.add("frames", len(sequence))
    health.add("fps", sequence.fps, "1/s")
    health.add("width", camera.width, "px")
    health.add("height", camera.height, "px")
    for name, value, unit in quality.numbers():
        health.add(name, value, unit)
    if camera.name == sequence.names[0]:
        health.remarks.extend(sequence.remarks)
    health.write(outputs["health"])
