"""The providers of each kind, by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from soar.config import settings
from soar.errors import ConfigError
from soar.perception.keypoints import KeypointProvider
from soar.perception.masks import MaskProvider, MaskSettings, MediaPipeMasks
from soar.perception.matting import NetworkMasks, NetworkSettings
from soar.perception.mediapipe import MediaPipeKeypoints, MediaPipeSettings
from soar.perception.sam import SamMasks, SamSettings

KEYPOINTS = {"mediapipe": (MediaPipeSettings, MediaPipeKeypoints)}
MASKS = {
    "mediapipe": (MaskSettings, lambda options, files, threads: MediaPipeMasks(options, files["models"], threads)),
    "sam": (SamSettings, SamMasks),
    "network": (NetworkSettings, NetworkMasks),
}


def _build(
    kinds: Mapping[str, tuple[type, Callable[..., Any]]], group: str, node: Mapping[str, Any], files: Any, threads: int
) -> Any:
    name = node.get("provider")
    if name not in kinds:
        raise ConfigError(
            f"unknown provider {group}.provider", expected=", ".join(kinds), got=repr(name), cure=f"see conf/{group}"
        )
    schema, provider = kinds[name]
    return provider(settings(schema, node, group), files, threads)


def keypoint_provider(node: Mapping[str, Any], models: Path, threads: int) -> KeypointProvider:
    """The keypoint provider that the configuration node ``keypoints`` names.

    Raises:
        ConfigError: an unknown provider or setting.
        ModelFileError: a network is missing or corrupt.
    """
    return _build(KEYPOINTS, "keypoints", node, models, threads)


def mask_provider(node: Mapping[str, Any], files: Mapping[str, Path], threads: int) -> MaskProvider:
    """The estimator of masks that the configuration node ``masks`` names; errors as :func:`keypoint_provider`.

    Args:
        node: the configuration.
        files: ``models``, the folder of installed networks, and by its key each file that the configuration names.
        threads: threads of one inference.
    """
    return _build(MASKS, "masks", node, files, threads)
