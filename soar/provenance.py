"""The provenance record beside every artifact: what made it, from what, with what, on what."""

from __future__ import annotations

import datetime
import platform
import resource
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from soar import __version__
from soar.artifacts import members, read_json, sha256_file, write_json
from soar.stages import Job

_LIBRARIES = ("torch", "numpy", "opencv-contrib-python-headless", "onnxruntime")


def record(
    path: Path,
    stage: str,
    job: Job,
    inputs: Mapping[str, Path],
    outputs: Mapping[str, Path],
    cfg: Mapping[str, Any],
    seconds: float,
) -> None:
    """Write the provenance record of one finished job.

    Args:
        path: where to write it.
        stage: the stage that ran.
        job: what it ran on.
        inputs, outputs: its files; of a folder, every file in it.
        cfg: the configuration slice it saw.
        seconds: wall time.
    """
    value = {
        "stage": stage,
        "sequence": job.sequence,
        "camera": job.camera,
        "config": cfg,
        "seed": job.seed,
        "code": {"soar": __version__, "fingerprint": job.code},
        "inputs": dict(_digests(inputs)),
        "outputs": dict(_digests(outputs)),
        "models": _models(inputs.get("models")),
        "device": {"kind": "cpu", "machine": platform.machine(), "threads": job.threads},
        "versions": {"python": platform.python_version()} | {name: version(name) for name in _LIBRARIES},
        "wall_seconds": round(seconds, 3),
        "peak_memory_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        "finished": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    }
    write_json(path, value)


def _digests(files: Mapping[str, Path]) -> Iterator[tuple[str, str]]:
    for name, path in sorted(files.items()):
        if name == "models":
            continue
        for member in members(path):
            yield (name if member == path else f"{name}/{member.relative_to(path)}"), sha256_file(member)


def _models(manifest: Path | None) -> Any:
    return read_json(manifest / "manifest.json") if manifest is not None else {}
