"""What stages read instead of estimating it, where a dataset knows it: their input ``given``."""

from __future__ import annotations

from pathlib import Path

from soar.artifacts import ImageArchive
from soar.errors import ArtifactError


def given_plane(path: Path, plane: str, frames: int) -> ImageArchive:
    """One plane of the stage ``maps``.

    Raises:
        ArtifactError: it does not hold a picture for each of the sequence's ``frames``.
    """
    archive = ImageArchive(path, plane)
    if len(archive) != frames:
        raise ArtifactError(
            f"{path} does not belong to this sequence", expected=f"{frames} pictures of {plane}", got=str(len(archive)),
            cure="delete the file and run snakemake; it is made again",
        )  # fmt: skip
    return archive
