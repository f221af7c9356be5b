"""The footage of one camera beside the avatar seen through it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.artifacts import read_npz
from soar.avatar.surfels import Avatar
from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.optimise.views import Views
from soar.progress import track
from soar.report.footage import RenderSettings, panels, thinned
from soar.report.shots import Shot
from soar.report.video import write_video
from soar.stages import Job
from soar.stages._rig import Rig


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Write the video of ``job.camera``: photograph, avatar, normals."""
    options = settings(RenderSettings, cfg["render"], "render").views
    puppet = Rig.read(inputs, cfg).puppet(Avatar.read(inputs["avatar"]))
    views = Views.of(str(job.camera), read_npz(inputs["crops"]))
    shown = thinned(len(views), options.max_frames)

    def frames():
        for index in track(shown, f"view {views.camera}", len(shown)):
            shot = Shot.beside(views, index, puppet)
            yield panels(views.rgb[index], shot.on_white(), shot.normals_on_white(), height=options.height)

    write_video(outputs["view"], frames(), Sequence.read(inputs["sequence"]).fps / shown.step)
