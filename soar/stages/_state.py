"""Whose a state in the scratch folder is."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.artifacts import members, sha256_file
from soar.stages import Job


def state_key(inputs: Mapping[str, Path], cfg: Mapping[str, Any], job: Job) -> str:
    """Digest of everything that determines the result of a job: a state of another run is never continued."""
    digest = hashlib.sha256(json.dumps([cfg, job.sequence, job.seed, job.code], sort_keys=True).encode())
    for name, path in sorted(inputs.items()):
        if name == "models":
            continue  # weights are pinned by their own sha256
        for file in members(path):
            label = file.relative_to(path) if path.is_dir() else file.name
            digest.update(f"{name}/{label} {sha256_file(file)}\n".encode())
    return digest.hexdigest()
