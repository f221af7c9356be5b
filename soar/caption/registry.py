"""The caption providers, by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from soar.caption.openai import OpenAI, OpenAISettings
from soar.caption.records import CaptionProvider
from soar.caption.template import Template, TemplateSettings
from soar.caption.text import Text, TextSettings
from soar.config import settings
from soar.errors import ConfigError
from soar.raster import RasterSettings

PROVIDERS = {"template": (TemplateSettings, Template), "text": (TextSettings, Text), "openai": (OpenAISettings, OpenAI)}


def caption_provider(node: Mapping[str, Any], raster: RasterSettings) -> CaptionProvider:
    """The provider that the configuration node ``caption`` names.

    Raises:
        ConfigError: an unknown provider or setting.
    """
    name = node.get("provider")
    if name not in PROVIDERS:
        raise ConfigError(
            "unknown provider caption.provider", expected=", ".join(PROVIDERS), got=repr(name), cure="see conf/caption"
        )
    schema, kind = PROVIDERS[name]
    provider: CaptionProvider = kind(settings(schema, node, "caption"), raster)
    if provider.frames < 1:
        raise ConfigError("caption.frames", expected="1 or more", got=str(provider.frames))
    return provider
