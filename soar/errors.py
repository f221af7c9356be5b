"""Named errors: what was expected, what came, and what to do about it.

Every error a user can cause is a :class:`SoarError`. The command line prints it without a stack trace and
exits with :attr:`SoarError.exit_code`; anything else is a defect of ours and keeps its trace.
"""

from __future__ import annotations


class SoarError(Exception):
    """A failure with a cause the user can act on.

    Args:
        what: what went wrong, naming the file, key or value concerned.
        expected: what would have been right.
        got: what came instead.
        cure: what to do about it; without one, what the class says.
    """

    exit_code = 2
    default_cure = ""

    def __init__(self, what: str, *, expected: str = "", got: str = "", cure: str = "") -> None:
        cure = cure or self.default_cure
        self.what, self.expected, self.got, self.cure = what, expected, got, cure
        parts = [what]
        if expected:
            parts.append(f"  expected: {expected}")
        if got:
            parts.append(f"  got:      {got}")
        if cure:
            parts.append(f"  to do:    {cure}")
        super().__init__("\n".join(parts))


class ConfigError(SoarError):
    """An unknown, missing or ill-typed configuration value."""

    default_cure = "correct the value in conf/ or in the override; conf/README.md lists keys and options"


class InputError(SoarError):
    """A video, image, folder or table of the user's that cannot be used."""


class CalibrationError(InputError):
    """Camera parameters that are malformed or do not match the frames."""

    default_cure = "correct the calibration; docs/data.md has its form"


class SubjectError(InputError):
    """Nobody, several equally likely people, or too little of one person in view."""


class ArtifactError(SoarError):
    """A file of ours that is missing, truncated or of another layout than the reader's."""

    default_cure = "delete the file and run snakemake; it is made again"


class ModelFileError(SoarError):
    """Weights that are missing, corrupt, unsafe, or of the wrong shape."""

    default_cure = "delete the file and fetch it again; if that does not help, report it"


class StorageError(SoarError):
    """A disk that is full or not writable."""


class ServiceError(SoarError):
    """A service on the network that is down, slow, refuses, or answers nonsense."""

    default_cure = "choose another provider, or try again later"


class NumericalError(SoarError):
    """An optimisation that produced NaN or infinity; the last good state is kept."""
