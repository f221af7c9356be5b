"""One file per stage: files and configuration in, artifacts out. The only floor that knows the file layout."""

from __future__ import annotations

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class Job:
    """What a stage needs to know besides its files and its configuration.

    Attributes:
        sequence: name of the sequence.
        camera: name of the camera for stages that run per camera, else None.
        seed: seed of every random generator the stage creates.
        threads: threads the stage may use.
        scratch: folder for resumable state, outside the declared outputs; removed after success.
        code: fingerprint of the code that runs; resumable state of other code is not continued.
    """

    sequence: str
    camera: str | None
    seed: int
    threads: int
    scratch: Path
    code: str = ""
