"""Packages that only this prior needs."""

from __future__ import annotations

import importlib
from typing import Any

from soar.errors import ConfigError


def extra(name: str) -> Any:
    """Import a package of the optional extra ``imagedream``.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"the prior imagedream needs the package {name}: {error}",
            cure="run `pip install 'soar-avatar[imagedream]'`",
        ) from error
