"""Providers of front and back normal maps, by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from soar.config import settings
from soar.errors import ConfigError
from soar.perception.body_normals import BodyNormals, BodyNormalSettings
from soar.perception.icon import IconNormals, IconSettings
from soar.perception.normal_files import NormalFiles, NormalFileSettings
from soar.perception.normal_maps import Context, Crop, encode, sign_test
from soar.perception.normal_network import NormalModel, NormalModelSettings
from soar.perception.sapiens import SapiensNormals, SapiensSettings

__all__ = ["Context", "Crop", "NormalProvider", "encode", "normal_provider", "sign_test"]


class NormalProvider(Protocol):
    """Estimates both maps of one crop.

    Attributes:
        remarks: sentences the user should read.
    """

    remarks: Sequence[str]

    def maps(self, crop: Crop) -> tuple[np.ndarray, np.ndarray]:
        """Front and back normals, each (H, W, 3) float32; see :mod:`soar.perception.normal_maps`."""
        ...


PROVIDERS = {
    "body": (BodyNormalSettings, BodyNormals),
    "mini": (NormalModelSettings, NormalModel),
    "icon": (IconSettings, IconNormals),
    "sapiens": (SapiensSettings, SapiensNormals),
    "files": (NormalFileSettings, NormalFiles),
}


def normal_provider(node: Mapping[str, Any], context: Context) -> NormalProvider:
    """The provider that the configuration node ``normals`` names.

    Raises:
        ConfigError: an unknown provider or setting, or a device that is not there.
        ModelFileError: the provider's network is missing, altered, or of another signature.
        InputError: files of the user's that are missing or cannot be used.
    """
    name = node.get("provider")
    if name not in PROVIDERS:
        raise ConfigError(
            "unknown provider normals.provider", expected=", ".join(PROVIDERS), got=repr(name), cure="see conf/normals"
        )
    schema, provider = PROVIDERS[name]
    return provider(settings(schema, node, "normals"), context)
