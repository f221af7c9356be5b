"""The formats of body parameters, by the name that stands in the configuration."""

from __future__ import annotations

from pathlib import Path

from soar.errors import ConfigError
from soar.importers import amass, easymocap, gvhmr, params, phalp, romp, smplerx, smplifyx, wham
from soar.importers.archive import Archive, Known, Reader

FORMATS: dict[str, Reader] = {
    "smplerx": smplerx.read,
    "smplifyx": smplifyx.read,
    "easymocap": easymocap.read,
    "romp": romp.read,
    "phalp": phalp.read,
    "wham": wham.read,
    "gvhmr": gvhmr.read,
    "params": params.read,
}
"""Of footage: what is estimated of a person in its frames."""

MOTIONS: dict[str, Reader] = {"amass": amass.read}
"""Of no footage: motions to be played."""


def read_parameters(kind: str, path: Path, known: Known) -> Archive:
    """The people in ``path``, which a tool of the given kind wrote.

    Raises:
        ConfigError: there is no such format.
        InputError: files are missing, damaged, or not of this tool.
    """
    readers = FORMATS | MOTIONS
    if kind not in readers:
        raise ConfigError("unknown format of body parameters", expected=", ".join(readers), got=kind)
    return readers[kind](path, known)
