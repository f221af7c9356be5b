"""The providers of each kind, by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soar.config import settings
from soar.errors import ConfigError
from soar.perception.keypoints import KeypointProvider
from soar.perception.masks import MaskProvider, MaskSettings, MediaPipeMasks
from soar.perception.mediapipe import MediaPipeKeypoints, MediaPipeSettings

KEYPOINTS = {"mediapipe": (MediaPipeSettings, MediaPipeKeypoints)}
MASKS = {"mediapipe": (MaskSettings, MediaPipeMasks)}


def _build(
    kinds: Mapping[str, tuple[type, type]], group: str, node: Mapping[str, Any], models: Path, threads: int
) -> Any:
    name = node.get("provider")
    if name not in kinds:
        raise ConfigError(
            f"unknown provider {group}.provider", expected=", ".join(kinds), got=repr(name), cure=f"see conf/{group}"
        )
    schema, provider = kinds[name]
    return provider(settings(schema, node, group), models, threads)


def keypoint_provider(node: Mapping[str, Any], models: Path, threads: int) -> KeypointProvider:
    """The keypoint provider that the configuration node ``keypoints`` names.

    Raises:
        ConfigError: an unknown provider or setting.
        ModelFileError: a network is missing or corrupt.
    """
    return _build(KEYPOINTS, "keypoints", node, models, threads)


def mask_provider(node: Mapping[str, Any], models: Path, threads: int) -> MaskProvider:
    """The mask provider that the configuration node ``masks`` names; errors as :func:`keypoint_provider`."""
    return _build(MASKS, "masks", node, models, threads)
