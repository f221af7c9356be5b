"""The stages: files each reads and writes, and configuration nodes it sees."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONF = ROOT / "conf"

MODELS = "data/models"
DEFAULT_BODY = f"{MODELS}/body/anny.npz"


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage of the DAG.

    Attributes:
        name: rule, module in ``soar/stages`` and folder of the artifacts.
        config: configuration nodes the stage sees.
        reads: input name -> ``stage/file`` of the same sequence. ``{camera}`` is the job's own camera in a per-camera
            stage; a sequence-level stage reads the file of every camera. ``=path`` is a path as it stands, but for
            ``{body_model}``, the record of the configured body.
        writes: output name -> file below the stage's folder; with ``{camera}`` in a per-camera stage.
        per_camera: one job per camera instead of one per sequence.
        cameras: which cameras a per-camera stage runs for: ``all`` or ``train``.
        evidence: whether the stage leaves a picture and health numbers.
        given: what the stage reads besides where its ``provider`` is ``dataset``: what the dataset knows already.
    """

    name: str
    config: tuple[str, ...]
    reads: Mapping[str, str]
    writes: Mapping[str, str]
    cameras: str = "all"
    per_camera: bool = False
    evidence: bool = True
    given: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def files(self) -> dict[str, str]:
        """All outputs, with the evidence and the provenance record that every stage leaves."""
        prefix = "{camera}." if self.per_camera else ""
        extra = {"health": f"{prefix}health.json", "evidence": f"{prefix}evidence.jpg"} if self.evidence else {}
        return {**self.writes, **extra, "provenance": f"{prefix}provenance.json"}


_MODELS = {"models": f"={MODELS}/manifest.json"}
_BODY_MODEL = {"body_model": "={body_model}"}
_SEQUENCE = {"sequence": "ingest/sequence.json"}
_FRAMES = {"frames": "frames/{camera}.zip"}
_MASKS = {"masks": "masks/{camera}.zip"}
_KEYPOINTS = {"keypoints": "keypoints/{camera}.npz"}
_CALIBRATION = {"calibration": "calibrate/calibration.json"}
_CAMERAS = {"calibration": "body/cameras.json"}
_POSED = {**_SEQUENCE, **_BODY_MODEL, "body": "body/body.npz", "crops": "crops/{camera}.npz"}

STAGES: dict[str, Stage] = {
    stage.name: stage
    for stage in (
        Stage("ingest", ("dataset",), {}, {"sequence": "sequence.json"}, evidence=False),
        Stage("frames", ("dataset",), _SEQUENCE, {"frames": "{camera}.zip"}, per_camera=True),
        Stage("truth", ("dataset",), _SEQUENCE | _BODY_MODEL, {"body": "body.npz", "surface": "surface.npz"}),
        Stage("maps", ("dataset",), _SEQUENCE, {"maps": "{camera}.zip"}, per_camera=True),
        Stage(
            "keypoints",
            ("keypoints",),
            _SEQUENCE | _FRAMES | _MODELS,
            {"keypoints": "{camera}.npz"},
            per_camera=True,
            given=_BODY_MODEL | {"given": "truth/body.npz"},
        ),
        Stage(
            "masks",
            ("masks",),
            _SEQUENCE | _FRAMES | _KEYPOINTS | _MODELS,
            {"masks": "{camera}.zip"},
            per_camera=True,
            given={"given": "maps/{camera}.zip"},
        ),
        Stage("calibrate", ("calibrate",), _SEQUENCE | _FRAMES | _KEYPOINTS, {"calibration": "calibration.json"}),
        Stage(
            "body",
            ("body", "monocular"),
            _SEQUENCE | _CALIBRATION | _FRAMES | _KEYPOINTS | _MASKS | _BODY_MODEL,
            {"body": "body.npz", "cameras": "cameras.json"},
            given={"given": "truth/body.npz"},
        ),
        Stage(
            "monocular",
            ("body", "monocular"),
            _SEQUENCE | _CAMERAS | _FRAMES | _KEYPOINTS | _MASKS | _BODY_MODEL | {"reference": "body/body.npz"},
            {"body": "body.npz"},
        ),
        Stage(
            "crops",
            ("crops",),
            _SEQUENCE | _CAMERAS | _FRAMES | _MASKS,
            {"crops": "{camera}.npz"},
            per_camera=True,
        ),
        Stage(
            "normals",
            ("normals", "raster"),
            _POSED,
            {"normals": "{camera}.npz"},
            per_camera=True,
            cameras="train",
            given={"given": "maps/{camera}.zip"},
        ),
        Stage("caption", ("caption", "raster"), _POSED, {"caption": "caption.json"}),
        Stage("paint", ("avatar", "paint", "raster"), _POSED, {"avatar": "avatar.safetensors"}),
        Stage(
            "reconstruct",
            ("avatar", "reconstruct", "raster"),
            _POSED | _MODELS | {"normals": "normals/{camera}.npz", "paint": "paint/avatar.safetensors"},
            {"avatar": "avatar.safetensors", "curves": "curves.json"},
        ),
        Stage(
            "occlusion",
            ("occlusion", "raster"),
            _POSED | {"avatar": "reconstruct/avatar.safetensors"},
            {"avatar": "avatar.safetensors", "occlusion": "occlusion.json"},
        ),
        Stage(
            "refine",
            ("avatar", "reconstruct", "refine", "prior", "raster"),
            _POSED
            | _MODELS
            | {
                "normals": "normals/{camera}.npz",
                "avatar": "occlusion/avatar.safetensors",
                "caption": "caption/caption.json",
            },
            {"avatar": "avatar.safetensors", "curves": "curves.json"},
        ),
        Stage(
            "render",
            ("render", "raster"),
            _POSED | {"avatar": "refine/avatar.safetensors"},
            {"turntable": "turntable.webm"},
        ),
        Stage(
            "views",
            ("render", "raster"),
            _POSED | {"avatar": "refine/avatar.safetensors"},
            {"view": "{camera}.webm"},
            per_camera=True,
            evidence=False,
        ),
        Stage(
            "evaluate",
            ("evaluate", "raster"),
            _POSED
            | _MODELS
            | {
                "avatar": "refine/avatar.safetensors",
                "unrefined": "occlusion/avatar.safetensors",
                "paint": "paint/avatar.safetensors",
            },
            {"metrics": "metrics.json", "table": "per_frame.csv", "sheet": "comparison.jpg"},
        ),
    )
}

BROUGHT = ("source", "network", "encoder", "decoder", "detector")
"""Keys of a stage's configuration that name a file or folder of the user's: an input of the stage, of the same name."""

SETUP = ("fetch", "models", "body_model")
"""Set-up stages: they fill ``data/`` and know no sequence."""

REPORT = {
    "report": "report.html",
    "markdown": "report.md",
    "table": "metrics.csv",
    "provenance": "provenance.json",
}
"""Files of the ``report`` stage, below results/{dataset}/report."""
