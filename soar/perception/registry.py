"""The providers of each kind, by the name that stands in the configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from soar.config import settings
from soar.datasets.sequence import Sequence
from soar.errors import ConfigError
from soar.perception.keypoints import KeypointProvider
from soar.perception.masks import MaskProvider, MaskSettings, MediaPipeMasks
from soar.perception.matting import NetworkMasks, NetworkSettings
from soar.perception.mediapipe import MediaPipeKeypoints, MediaPipeSettings
from soar.perception.openpose_json import OpenPoseKeypoints, OpenPoseSettings
from soar.perception.sam import SamMasks, SamSettings
from soar.perception.simcc import SimccKeypoints, SimccSettings

KEYPOINTS = {
    "mediapipe": (
        MediaPipeSettings,
        lambda options, files, threads, *_: MediaPipeKeypoints(options, files["models"], threads),
    ),
    "simcc": (SimccSettings, lambda options, files, threads, *_: SimccKeypoints(options, files, threads)),
    "openpose": (OpenPoseSettings, OpenPoseKeypoints),
}
MASKS = {
    "mediapipe": (MaskSettings, lambda options, files, threads: MediaPipeMasks(options, files["models"], threads)),
    "sam": (SamSettings, SamMasks),
    "network": (NetworkSettings, NetworkMasks),
}


def _build(
    kinds: Mapping[str, tuple[type, Callable[..., Any]]], group: str, node: Mapping[str, Any], *given: Any
) -> Any:
    name = node.get("provider")
    if name not in kinds:
        raise ConfigError(
            f"unknown provider {group}.provider", expected=", ".join(kinds), got=repr(name), cure=f"see conf/{group}"
        )
    schema, provider = kinds[name]
    return provider(settings(schema, node, group), *given)


def keypoint_provider(
    node: Mapping[str, Any], files: Mapping[str, Path], threads: int, sequence: Sequence, camera: str
) -> KeypointProvider:
    """The keypoint provider that the configuration node ``keypoints`` names.

    Args:
        node: the configuration.
        files: ``models``, the folder of installed networks, and by its key each file that the configuration names.
        threads: threads of one inference.
        sequence: the sequence the frames are of.
        camera: and their camera.

    Raises:
        ConfigError: an unknown provider or setting.
        ModelFileError: a network is missing or corrupt.
    """
    return _build(KEYPOINTS, "keypoints", node, files, threads, sequence, camera)


def mask_provider(node: Mapping[str, Any], files: Mapping[str, Path], threads: int) -> MaskProvider:
    """The estimator of masks that the configuration node ``masks`` names; errors as :func:`keypoint_provider`.

    Args:
        node: the configuration.
        files: ``models``, the folder of installed networks, and by its key each file that the configuration names.
        threads: threads of one inference.
    """
    return _build(MASKS, "masks", node, files, threads)
