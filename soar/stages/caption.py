"""What the person of the sequence looks like, in one sentence: the text prompt of the generative refinement."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import read_npz, write_image, write_json
from soar.body.motion import BodyMotion
from soar.body.record import BodyModel
from soar.caption.records import Caption, Footage, Sighting
from soar.caption.registry import caption_provider
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.errors import SubjectError
from soar.health import Health
from soar.raster import RasterSettings
from soar.report.pictures import composite, grid, label, spread
from soar.stages import Job
from soar.stages._posed import posed_in_crops

_SHOWN = 4  # photographs on the evidence picture


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the sentence and what it rests on, a picture of both, and health."""
    provider = caption_provider(cfg["caption"], settings(RasterSettings, cfg["raster"], "raster"))
    body = BodyModel.load(inputs["body_model"])
    sightings = _sightings(inputs, body, provider.frames)
    caption = provider.caption(Footage(job.sequence, body, sightings))
    shown = [f"{sighting.camera} {sighting.frame}" for sighting in sightings]
    write_json(
        outputs["caption"],
        {
            "text": caption.text,
            "provider": cfg["caption"]["provider"],
            "evidence": caption.evidence | {"photographs": shown},
        },
    )
    write_image(outputs["evidence"], _sheet(caption, sightings))
    health = Health("caption")
    for name, value in ({"words": len(caption.text.split())} | caption.numbers).items():
        health.add(name, value)
    for remark in caption.remarks:
        health.remark(remark)
    health.write(outputs["health"])


def _sightings(inputs: Mapping[str, Path], body: BodyModel, count: int) -> tuple[Sighting, ...]:
    """``count`` crops that show the person, spread evenly over all of the training cameras, camera by camera."""
    motion = BodyMotion.read(inputs["body"])
    cameras = {name: read_npz(inputs["crops"] / f"{name}.npz") for name in Sequence.read(inputs["sequence"]).train}
    every = [(name, i) for name, crops in cameras.items() for i in np.flatnonzero((crops["alpha"] > 127).any((1, 2)))]
    if not every:
        raise SubjectError(
            "no crop of the training cameras shows the person", cure="look at the evidence pictures of the masks stage"
        )
    taken = [every[k] for k in spread(len(every), count)]
    chosen = {name: [i for camera, i in taken if camera == name] for name in cameras}
    return tuple(
        Sighting(name, int(crops["frame_index"][i]), crops["rgb"][i], crops["alpha"][i], vertices, pinhole)
        for name, crops in cameras.items()
        for i, vertices, pinhole in posed_in_crops(body, motion, crops, chosen[name])
    )


def _sheet(caption: Caption, sightings: tuple[Sighting, ...]) -> np.ndarray:
    """The sentence over the photographs, what was made of them, and the colours that were measured."""
    chosen = spread(len(sightings), _SHOWN)
    pictures = [composite(sightings[i].rgb, sightings[i].alpha) for i in chosen]
    labels = [f"{sightings[i].camera}  frame {sightings[i].frame}" for i in chosen]
    if caption.pictures:
        pictures += [caption.pictures[i] for i in chosen]
        labels += ["what was looked at"] * len(chosen)
    sheet = grid(pictures, len(chosen), labels)
    if caption.swatches:
        count, width = len(caption.swatches), sheet.shape[1]
        tiles = [np.full((60, (width - 4 * (count - 1)) // count, 3), swatch.colour) for swatch in caption.swatches]
        row = grid(tiles, count, [swatch.words for swatch in caption.swatches])
        row = np.pad(row, ((4, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255)
        sheet = np.concatenate([sheet, row])
    return label(sheet, caption.text, size=22)
