"""Fingerprints of the code a stage runs."""

from __future__ import annotations

import ast
import functools
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.workflow.configuration import canonical
from soar.workflow.table import ROOT


def _strip_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            body = node.body
            first = body[0] if body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = body[1:] or [ast.Pass()]
    return tree


def _imports(tree: ast.Module, package: str) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parent, base]) if base else ".".join(parent)
            found.update([base, *(f"{base}.{alias.name}" for alias in node.names)])
    return {name for name in found if name.split(".")[0] == "soar"}


@functools.cache
def _package_data() -> list[tuple[str, Path]]:
    """Files in folders ``data`` of the package, and templates: the name that a module which reads one holds, and path.

    A record goes with its file: who names the file reads both.
    """
    found = (path for pattern in ("data/**/*", "*.html") for path in (ROOT / "soar").rglob(pattern) if path.is_file())
    return [(path.stem if path.parent.name == "records" else path.name, path) for path in sorted(found)]


@functools.cache
def _module(name: str) -> tuple[str, frozenset[str]] | None:
    """Meaning (code without comments and docstrings) and soar imports of a module; None if there is none."""
    base = ROOT.joinpath(*name.split("."))
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    if not path.is_file():
        return None
    tree = ast.parse(path.read_text(encoding="utf-8"))
    package = name if base.is_dir() else name.rpartition(".")[0]
    imports = frozenset(_imports(tree, package))
    text = code = ast.unparse(_strip_docstrings(tree))
    for source in sorted((path.parent / "native").glob("*.[ch]*")):
        text += re.sub(r"/\*.*?\*/|//[^\n]*|\s+", " ", source.read_text(encoding="utf-8"), flags=re.S)
    for label, data in _package_data():
        if label in code:
            text += hashlib.sha256(data.read_bytes()).hexdigest()
    return text, imports


def fingerprint(stage: str, cfg: Mapping[str, Any]) -> str:
    """Hash of the code a stage runs: its module and everything of soar that it imports, directly or not.

    Of the dataset adapters only the one that ``cfg``, the stage's configuration, names counts. Comments, docstrings and
    layout do not count. Native sources beside an imported module do, and data files of the package that it names.
    """
    from soar.datasets import adapter_module

    adapters = (adapter_module(cfg["dataset"]),) if "dataset" in cfg else ()
    return _fingerprint(f"soar.stages.{stage}", *adapters)


@functools.cache
def _fingerprint(*modules: str) -> str:
    pending, seen = [*modules], {}
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        module = _module(name)
        seen[name] = module[0] if module else ""
        if module:
            parents = {name.rsplit(".", i)[0] for i in range(1, name.count(".") + 1)}
            pending.extend(module[1] | parents)
    meaning = canonical({name: text for name, text in seen.items() if text})
    return hashlib.sha256(meaning.encode()).hexdigest()[:16]
