"""The record of a body that the user brings; the default body's is made with the other model files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.body.record import BodyModel
from soar.body.smplx_file import read_smplx
from soar.body.smplx_record import SmplxSettings, build_record
from soar.config import settings
from soar.stages import Job


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Convert the model file ``source``, which is read only here.

    Raises:
        ModelFileError: the file is damaged or not of SMPL-X.
        ConfigError: the configured body is not SMPL-X, or the file has too few shape components.
    """
    options = settings(SmplxSettings, cfg["body_model"], "body_model")
    build_record(read_smplx(inputs["source"]), BodyModel.load(inputs["default"]), options).save(outputs["body_model"])
