"""Imports point down only: the picture in docs/architecture.md, enforced."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "soar"

FLOORS = [
    {"errors"},
    {"config", "artifacts", "packages", "progress", "geometry", "devices"},
    {"health", "raster"},
    {"models"},
    {"body", "networks"},
    {"perception", "importers", "caption", "datasets", "synthetic", "priors"},
    {"avatar"},
    {"losses", "metrics"},
    {"optimise"},
    {"report"},
    {"workflow"},
    {"stages", "provenance", "train"},
    {"cli"},
    {"__main__"},
]
LEVEL = {name: level for level, floor in enumerate(FLOORS) for name in floor}
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def _floor(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_down(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = (
                [f"{node.module}.{alias.name}" for alias in node.names]
                if node.module == "soar"
                else [node.module or ""]
            )
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] != "soar" or len(parts) < 2 or parts[1] == "__version__":
                continue
            assert LEVEL[parts[1]] <= LEVEL[_floor(path)], f"{path.name} of {_floor(path)} imports {name} above it"


def test_parsing_the_workflow_loads_no_numerical_library() -> None:
    import subprocess
    import sys

    code = (
        "import sys, soar.workflow; soar.workflow.Workflow(); "
        "heavy = {'torch', 'cv2', 'onnxruntime', 'trimesh', 'kornia', 'scipy'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=PACKAGE.parent
    )
    assert result.returncode == 0, result.stderr
