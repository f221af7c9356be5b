"""Building and finding the native library: one whole file from many jobs, a loud fall-back without a compiler."""

import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from soar.errors import ConfigError
from soar.raster import build, library, rasterise
from tests.raster.scenes import VIEW, cloud, raster


@pytest.fixture
def no_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """A machine without compiler, installed library or cache."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(build, "installed_path", lambda: tmp_path / "nothing.so")
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    library._load.cache_clear()
    library._warn.cache_clear()
    yield
    library._load.cache_clear()
    library._warn.cache_clear()


@pytest.mark.usefixtures("no_library")
def test_without_a_compiler_auto_warns_once_and_native_is_an_error():
    assert not library.has_native()
    surfels = cloud(20)
    surfels32 = [t.float() for t in surfels]
    with pytest.warns(RuntimeWarning, match="pip install ziglang"):
        rasterise(*surfels32, VIEW, side="front", settings=raster(backend="auto"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rasterise(*surfels32, VIEW, side="front", settings=raster(backend="auto"))
    with pytest.raises(ConfigError, match="no C\\+\\+ compiler"):
        rasterise(*surfels32, VIEW, side="front", settings=raster(backend="native"))


def test_compiler_order(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("CXX", "ccache my-c++")
    assert build.compiler() == ["ccache", "my-c++"]
    monkeypatch.delenv("CXX")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: object() if name == "ziglang" else None)
    assert build.compiler() == [sys.executable, "-m", "ziglang", "c++"]
    (tmp_path / "g++").write_text("#!/bin/sh\n")
    (tmp_path / "g++").chmod(0o755)
    assert build.compiler() == [str(tmp_path / "g++")]


def test_the_name_follows_the_sources(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    for name in ("a.cpp", "b.h"):
        (tmp_path / name).write_text("1")
    monkeypatch.setattr(build, "SOURCES", tmp_path)
    first = build.installed_path()
    assert build.installed_path() == first
    assert build.digest("gcc 12") != build.digest("gcc 13")
    (tmp_path / "b.h").write_text("2")
    assert build.installed_path() != first


def fake_compiler(folder: Path, body: str) -> list[str]:
    """An executable that stands for a compiler; ``$out`` is the file it is asked to make."""
    path = folder / "cc"
    path.write_text(f'#!/bin/sh\nfor last; do :; done\nout="$last"\n{body}\n')
    path.chmod(0o755)
    return [str(path)]


def test_jobs_that_build_at_once_leave_one_whole_file(tmp_path: Path):
    command = fake_compiler(tmp_path, 'printf half > "$out"; sleep 0.1; printf whole > "$out"')
    target = tmp_path / "cache" / "raster.so"
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: build.compile_library(command, target), range(4)))
    assert target.read_text() == "whole"
    assert os.listdir(target.parent) == ["raster.so"]


def test_a_failing_compiler_is_quoted(tmp_path: Path):
    command = fake_compiler(tmp_path, "echo the reason >&2; exit 1")
    with pytest.raises(build.BuildError, match="the reason"):
        build.compile_library(command, tmp_path / "raster.so")
    assert not (tmp_path / "raster.so").exists()
    with pytest.raises(build.BuildError, match="cannot build"):
        build.compile_library([str(tmp_path / "missing")], tmp_path / "raster.so")


def test_build_file_needs_nothing_installed():
    """setup.py loads it in an isolated environment."""
    code = f"import runpy; print(runpy.run_path({str(build.__file__)!r})['digest']())"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == build.digest()
