"""Complete what was never seen: distil a multi-view prior into shape, then into texture."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soar.artifacts import read_json, write_image, write_json
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.health import Health
from soar.metrics.colour import saturation
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.reconstruct import Observation, ReconstructSettings
from soar.optimise.refine import Guide, PhaseSettings, RefineSettings, refine
from soar.optimise.surround import Surround
from soar.priors.protocol import Domain
from soar.priors.registry import prior
from soar.report.pictures import grid
from soar.stages import Job
from soar.stages._rig import Observed, agreement, canonical_shots, perceptual
from soar.stages._state import state_key

_ANGLES = 8  # of the avatar on the evidence sheet
_SIZE = 400  # pixels, height of its pictures
_JUDGED = 10  # frames of each training camera in the health numbers


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the avatar, the loss curves, a sheet of the avatar before and after from all sides, and health."""
    options = settings(RefineSettings, cfg["refine"], "refine")
    reconstruction = settings(ReconstructSettings, cfg["reconstruct"], "reconstruct")
    attributes = settings(AvatarSettings, cfg["avatar"], "avatar")
    observed = Observed.read(inputs, cfg)
    start = Avatar.read(inputs["avatar"])
    articulation = observed.articulation
    seen = Observation(
        observed.views, articulation, perceptual(inputs, reconstruction), reconstruction, observed.raster
    )
    key = state_key(inputs, cfg, job)
    avatar, curves = start, {}
    guides = _guides(observed, options, inputs, cfg, job)
    for number, (name, phase) in enumerate((("shape", options.shape), ("texture", options.texture))):
        checkpoint = Checkpoint(job.scratch / f"{name}.pt", f"{name} {key}", phase.checkpoint_seconds)
        avatar, curve = refine(
            name,
            avatar,
            articulation,
            observed.body.left,
            seen,
            guides[name],
            attributes,
            phase,
            observed.raster,
            job.seed + number,
            checkpoint,
        )
        curves |= {f"{name}/{term}": values for term, values in curve.items()}
    avatar.write(outputs["avatar"])
    write_json(outputs["curves"], curves)
    write_image(outputs["evidence"], _sheet(observed, start, avatar))
    _health(observed, start, avatar, curves).write(outputs["health"])


def _guides(
    observed: Observed, options: RefineSettings, inputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job
) -> dict[str, Guide[Any] | None]:
    """What each phase distils; None where it distils nothing. The prior is opened only if it is asked."""
    phases: dict[str, tuple[PhaseSettings, Domain]] = {
        "shape": (options.shape, "normal"),
        "texture": (options.texture, "colour"),
    }
    guides: dict[str, Guide[Any] | None] = dict.fromkeys(phases)
    guided = {name: domain for name, (phase, domain) in phases.items() if phase.steps and phase.weights.sds}
    if not guided:
        return guides
    model = prior(cfg["prior"], inputs["models"], job.threads)
    text = read_json(inputs["caption"])["text"]
    up = Sequence.read(inputs["sequence"]).up
    surround = Surround(observed.body, observed.motion, up, options.views, model.size)
    crops = [(v, i) for v, view in enumerate(observed.views) for i in range(len(view))]
    asked = [(name, crop) for crop in crops for name in guided]
    made = (surround.conditions(observed.views[v], i, guided.values(), text) for v, i in crops)
    conditions = list(itertools.chain.from_iterable(made))
    prompts = dict(zip(asked, model.prepare(conditions), strict=True))
    for name, domain in guided.items():
        guides[name] = Guide(model, {crop: prompts[name, crop] for crop in crops}, surround, domain)
    return guides


def _sheet(observed: Observed, start: Avatar, avatar: Avatar) -> np.ndarray:
    """Colours and normals from all sides in the canonical pose, before above after."""
    before, after = (canonical_shots(observed, a, _ANGLES, _SIZE) for a in (start, avatar))
    rows = {
        "before": [shot.on_white() for shot in before],
        "after": [shot.on_white() for shot in after],
        "normals before": [shot.normals_on_white() for shot in before],
        "normals after": [shot.normals_on_white() for shot in after],
    }
    labels = [name if k == 0 else "" for name, row in rows.items() for k in range(len(row))]
    return grid([picture for row in rows.values() for picture in row], _ANGLES, labels)


def _health(observed: Observed, start: Avatar, avatar: Avatar, curves: Mapping[str, list[float]]) -> Health:
    health = Health("refine")
    (overlap_before, fidelity_before), (overlap, fidelity) = (
        agreement(observed.shots(a, _JUDGED)) for a in (start, avatar)
    )
    health.add("iou", overlap)
    health.add("iou_gain", overlap - overlap_before)
    health.add("white_crop_psnr", fidelity, "dB")
    health.add("white_crop_psnr_gain", fidelity - fidelity_before, "dB")
    unseen = (start.occlusion > 0.5).numpy()
    if unseen.any() and not unseen.all():
        colours = avatar.colours.numpy()
        strength = saturation(colours[~unseen])
        health.add("saturation_gap", abs(saturation(colours[unseen]) - strength) / max(strength, 1e-6))
        change = np.abs(avatar.colours.numpy() - start.colours.numpy()).mean(-1)
        health.add("colour_change_unseen", float(change[unseen].mean()))
        health.add("colour_change_seen", float(change[~unseen].mean()))
    for name, curve in curves.items():
        health.add(f"{name}/last", float(np.mean(curve[-max(len(curve) // 10, 1) :])))
    return health
