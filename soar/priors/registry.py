"""Priors by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.config import settings
from soar.errors import ConfigError
from soar.priors.imagedream.onnx import from_export
from soar.priors.imagedream.prior import ImageDreamSettings, from_checkpoint
from soar.priors.mini import MiniProvider, MiniSettings
from soar.priors.protocol import MultiViewPrior

PRIORS = {
    "mini": (MiniSettings, MiniProvider.bundled),
    "imagedream": (ImageDreamSettings, from_checkpoint),
    "onnx": (ImageDreamSettings, from_export),
}


def prior(node: Mapping[str, Any], models: Path, threads: int) -> MultiViewPrior[Any]:
    """The prior that the configuration node ``prior`` names.

    Raises:
        ConfigError: an unknown provider or setting, or a package that is not installed.
        ModelFileError: weights are missing or not the right ones.
    """
    name = node.get("provider")
    if name not in PRIORS:
        raise ConfigError(
            "unknown provider prior.provider", expected=", ".join(PRIORS), got=repr(name), cure="see conf/prior"
        )
    schema, make = PRIORS[name]
    return make(settings(schema, node, "prior"), models, threads)
