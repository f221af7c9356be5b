"""Compiles the native library. Standard library only: ``setup.py`` loads this file where nothing is installed yet."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCES = Path(__file__).resolve().parent / "native"
FLAGS = [
    *("-std=c++17", "-O3", "-shared", "-fPIC", "-pthread", "-fvisibility=hidden", "-Wno-psabi"),
    # The relaxations that matter for speed. Not -ffast-math: reassociation deletes the rounding in exp2.
    *("-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-ffp-contract=fast"),
]


class BuildError(Exception):
    """The library could not be compiled; the message says why and what to do."""


def compiler() -> list[str]:
    """The C++ compiler as an argument list: ``$CXX``, the system's, or the one in the ``ziglang`` package.

    Raises:
        BuildError: there is none.
    """
    if os.environ.get("CXX"):
        return shlex.split(os.environ["CXX"])
    for name in ("c++", "g++", "clang++"):
        if path := shutil.which(name):
            return [path]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "c++"]
    raise BuildError(
        "there is no C++ compiler: install g++ or clang++, or `pip install ziglang` (a compiler as a Python package), "
        "or name one in the environment variable CXX"
    )


def flags(command: list[str]) -> list[str]:
    """Compiler flags: x86-64-v3 (AVX2, FMA) on x86-64, the architecture's baseline elsewhere."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return FLAGS
    return [*FLAGS, "-mcpu=x86_64_v3" if "ziglang" in command else "-march=x86-64-v3"]


def digest(*more: str) -> str:
    """A name for the library made from these sources: a hash of sources, flags, machine and ``more``."""
    state = hashlib.sha256(" ".join([*FLAGS, sys.platform, platform.machine(), *more]).encode())
    for path in sorted([*SOURCES.glob("*.h"), *SOURCES.glob("*.cpp")]):
        state.update(path.name.encode() + b"\0" + path.read_bytes())
    return state.hexdigest()[:16]


def installed_path() -> Path:
    """The library that installation leaves beside these very sources; a stale one has another name."""
    return SOURCES / f"raster-{digest()}.so"


def cached_path(command: list[str]) -> Path:
    """The library compiled at first use: named by sources, flags and compiler version, in the user's cache folder."""
    try:
        version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise BuildError(f"the compiler {shlex.join(command)} does not run: {error}") from error
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "soar" / f"raster-{digest(shlex.join(command), version)}.so"


def compile_library(command: list[str], target: Path) -> None:
    """Compile the sources to ``target``. Jobs that do so at once each rename a complete file into place.

    Raises:
        BuildError: with the compiler's own words.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".build-") as folder:
            output = Path(folder) / target.name
            sources = [str(p) for p in sorted(SOURCES.glob("*.cpp"))]
            arguments = [*command, *flags(command), *sources, "-o", str(output)]
            run = subprocess.run(arguments, capture_output=True, text=True, check=False)
            if run.returncode:
                raise BuildError(f"{shlex.join(command)} cannot compile the native rasteriser:\n{run.stderr.strip()}")
            os.replace(output, target)
    except OSError as error:
        raise BuildError(f"cannot build {target}: {error}") from error
