"""What a file or folder of the user's is, and which provider takes it: ``python -m soar models check PATH``.

A module that reads such files lists the forms it reads as ``FORMS``, with the check that it makes itself before it
reads them; so what is told here and what a stage accepts cannot differ.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from soar.errors import InputError, ModelFileError, SoarError
from soar.models.onnx import Signature, compare
from soar.models.onnx_file import Ports, inspect

FOLDER = "/"
"""Stands for a folder among the suffixes of a form."""


@dataclasses.dataclass(frozen=True)
class Form:
    """A form of file or folder that a provider takes.

    Attributes:
        name: what it is, in words.
        use: the command that makes use of it, with PATH where the path goes; see :func:`overrides`.
        suffixes: of such files, lower case; :data:`FOLDER` for a folder.
        check: says in words what was found in one; raises a :class:`SoarError` for another.
    """

    name: str
    use: str
    suffixes: tuple[str, ...]
    check: Callable[[Path], str]


def overrides(*settings: str) -> str:
    """The command that runs the workflow with some overrides."""
    listed = ",".join(f'"{setting}"' for setting in settings)
    return f"snakemake --config 'overrides=[{listed}]'"


def ports(path: Path) -> Ports:
    """What a network takes and gives, see :func:`soar.models.onnx_file.inspect`; read once for all forms."""
    if not path.is_file():
        return inspect(path)
    state = path.stat()
    return _ports(path, state.st_mtime_ns, state.st_size)


@functools.lru_cache(16)
def _ports(path: Path, modified: int, size: int) -> Ports:
    return inspect(path)


def network(name: str, use: str, signature: Signature) -> Form:
    """The form of an ONNX file with a signature."""

    def check(path: Path) -> str:
        compare(path, signature, ports(path))
        return ""

    return Form(name, use, (".onnx",), check)


def networks(name: str, use: str, signatures: Mapping[str, Signature], besides: tuple[str, ...] = ()) -> Form:
    """The form of a folder of ONNX files, each with a signature, by name without ``.onnx``, and files ``besides``."""

    def check(path: Path) -> str:
        wanted = (*(f"{file}.onnx" for file in signatures), *besides)
        missing = [file for file in wanted if not (path / file).is_file()]
        if missing:
            raise ModelFileError(f"{path} lacks {', '.join(missing)}", expected=", ".join(wanted))
        for file, signature in signatures.items():
            compare(path / f"{file}.onnx", signature, ports(path / f"{file}.onnx"))
        return ", ".join(wanted)

    return Form(name, use, (FOLDER,), check)


@dataclasses.dataclass(frozen=True)
class Finding:
    """What comparing a path with a form gave: words about it, or why it is another form."""

    form: Form
    found: str
    error: SoarError | None


def identify(path: Path, forms: Iterable[Form]) -> list[Finding]:
    """Compare a file or folder with every form of its kind.

    Raises:
        InputError: it is not there.
        ModelFileError: it is an ONNX file that no stage would open.
    """
    if not path.exists():
        raise InputError(f"{path} is not there", cure="name a file or folder")
    suffix = FOLDER if path.is_dir() else path.suffix.lower()
    if suffix == ".onnx":
        ports(path)
    findings = []
    for form in forms:
        if suffix in form.suffixes:
            try:
                findings.append(Finding(form, form.check(path), None))
            except SoarError as error:
                findings.append(Finding(form, "", error))
    return findings


def report(path: Path, forms: Iterable[Form]) -> str:
    """What a file or folder is, which forms it fits, and the command that makes use of it.

    Raises:
        InputError: it is not there.
        ModelFileError: no stage would open it; or it fits no form: tells of each of its kind what is missing or
            different.
    """
    findings = identify(path, forms)
    lines = [f"{path}: {_contents(path)}"]
    for fit in (finding for finding in findings if finding.error is None):
        lines += [f"  fits: {fit.form.name}" + (f" ({fit.found})" if fit.found else "")]
        lines += [f"        {fit.form.use.replace('PATH', str(path))}"]
    if len(lines) > 1:
        return "\n".join(lines)
    for finding in findings:
        error = finding.error
        lines += [f"  not {finding.form.name}: {error.what.removeprefix(str(path)).lstrip(': ')}"]
        # What a network takes and gives is said above.
        parts = (("expected:", error.expected), ("got:     ", "" if path.suffix.lower() == ".onnx" else error.got))
        lines += [f"    {what} {text}" for what, text in parts if text]
    raise ModelFileError(
        "\n".join(lines), expected="" if findings else "a file or folder that a provider takes",
        cure="see docs/models.md for what can be brought, and in which form",
    )  # fmt: skip


def _contents(path: Path) -> str:
    """A path in a few words."""
    if path.is_dir():
        kinds = collections.Counter(file.suffix or "no suffix" for file in path.iterdir() if file.is_file())
        listed = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(5))
        folders = ", ".join(sorted(f"{entry.name}/" for entry in path.iterdir() if entry.is_dir())[:5])
        return f"a folder of {', '.join(filter(None, (listed, folders))) or 'nothing'}"
    size = f"{path.stat().st_size / 1e6:.1f} MB"
    if path.suffix.lower() != ".onnx":
        return f"a file of {size}"
    found = ports(path)
    takes, gives = (", ".join(map(str, side)) for side in (found.inputs, found.outputs))
    return f"an ONNX network of {size}\n  takes {takes}\n  gives {gives}"
