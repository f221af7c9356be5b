"""Installing with the compiler that comes by pip, and with none at all."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from soar.raster import build, library, rasterise_both
from tests.conftest import ROOT
from tests.raster.scenes import VIEW, cloud, raster

# Run where nothing of the checkout is on the path: every kernel twice, and what was warned of.
PROBE = """
import json, warnings
import torch
import soar
from soar.raster import Pinhole, RasterSettings, has_native, hash_encode, rasterise, rasterise_mesh

g = torch.Generator().manual_seed(0)
surfels = [torch.rand(60, 3, generator=g) + torch.tensor([-0.5, -0.5, 3.0]), torch.randn(60, 3, generator=g),
           torch.full((60,), 0.05), torch.rand(60, 3, generator=g), torch.zeros(60)]
view = Pinhole(40.0, 40.0, 16.0, 16.0, 32, 32)
render = {
    name: lambda name=name: rasterise(*surfels, view, side="front", settings=RasterSettings(1 / 12, True, True, name))
    for name in ("auto", "reference")
}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    images = [render["auto"]().planes for _ in range(2)]
    rasterise_mesh(surfels[0][:3], torch.tensor([[0, 1, 2]]), view, "front")
    hash_encode(torch.rand(5, 3, generator=g), torch.rand(2, 16, 2, generator=g), torch.tensor([4, 8]))
expected = render["reference"]().planes
print(json.dumps({
    "file": soar.__file__,
    "native": has_native(),
    "warnings": [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)],
    "alpha": float(expected[7].max()),
    "equal": all(torch.equal(image, expected) for image in images),
}))
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """What is installed, without a library that was built before."""
    folder = tmp_path / "project"
    leave_out = shutil.ignore_patterns("__pycache__", "*.so", ".build-*")
    shutil.copytree(ROOT / "soar", folder / "soar", ignore=leave_out)
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    return folder


def environment(folder: Path, *path: Path) -> dict[str, str]:
    """A machine without compilers of its own, which looks for modules in ``path`` first."""
    (folder / "bin").mkdir(exist_ok=True)
    changes = {"PATH": str(folder / "bin"), "PYTHONPATH": os.pathsep.join(map(str, path))}
    return {k: v for k, v in os.environ.items() if k != "CXX"} | changes


def run(arguments: list[str], folder: Path, variables: dict[str, str]) -> str:
    """Standard output and error of a python command that must succeed."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_without_a_compiler_it_installs_says_so_and_renders_with_the_reference(project: Path, tmp_path: Path) -> None:
    hidden, site = tmp_path / "hidden", tmp_path / "site"
    hidden.mkdir()
    (hidden / "sitecustomize.py").write_text("import sys\nsys.modules['ziglang'] = None\n")
    variables = environment(tmp_path, hidden) | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    offline = ["--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]
    said = run(["-m", "pip", "install", "-v", *offline, "--target", str(site), str(project)], tmp_path, variables)
    assert said.count("*** SOAR is installed WITHOUT its native rasteriser") == 1
    assert "pip install ziglang" in said
    assert not list(site.rglob("*.so"))
    variables["PYTHONPATH"] += f"{os.pathsep}{site}"
    report = json.loads(run(["-c", PROBE], tmp_path, variables).splitlines()[-1])
    assert Path(report["file"]).is_relative_to(site)
    assert not report["native"]
    assert len(report["warnings"]) == 1
    assert "slow reference rasteriser" in report["warnings"][0]
    assert "pip install ziglang" in report["warnings"][0]
    assert report["alpha"] > 0.5
    assert report["equal"]


@pytest.fixture
def own_library() -> Iterator[None]:
    """Forget the library of this process, before and after."""
    library._load.cache_clear()
    yield
    library._load.cache_clear()


@pytest.mark.usefixtures("own_library")
@pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None,
    reason="`pip install ziglang` brings this compiler; the first build takes it two minutes, later ones seconds",
)
def test_the_compiler_by_pip_builds_a_library_that_renders_as_the_reference(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variables = environment(tmp_path, Path(importlib.util.find_spec("ziglang").origin).parents[1])
    said = run(["setup.py", "build_ext", "--build-lib", str(tmp_path / "built")], project, variables)
    assert "WITHOUT" not in said
    (made,) = (tmp_path / "built").rglob("*.so")
    assert made.name == build.installed_path().name
    monkeypatch.setattr(build, "installed_path", lambda: made)
    surfels = cloud(2000)
    expected = rasterise_both(*surfels, VIEW, settings=raster(backend="reference"))
    got = rasterise_both(*(t.float() for t in surfels), VIEW, settings=raster(backend="native"))
    assert library._load()._name == str(made)
    for e, g in zip(expected, got, strict=True):
        assert e.alpha.mean() > 0.2
        assert (g.planes - e.planes).abs().mean() < 1e-6
