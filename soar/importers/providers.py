"""What gives the stage ``body`` its start: files of other tools, or a network."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from soar.body.observations import Observations
from soar.body.parameters import HandSpace
from soar.config import settings
from soar.errors import ConfigError
from soar.importers.archive import Archive, Known
from soar.importers.clip import ClipSettings
from soar.importers.pose_network import PoseNetwork
from soar.importers.registry import FORMATS, read_parameters


@dataclasses.dataclass(frozen=True)
class Footage:
    """What a provider may look at.

    Attributes:
        path: the file or folder that the configuration names.
        seen: keypoints of the one training camera.
        frames: its frames, (H, W, 3) uint8 RGB.
        frame_ids: their numbers in the recording.
        hands: what fingers are measured in; None leaves hands out.
        threads: that may be used.
    """

    path: Path
    seen: Observations
    frames: Sequence[np.ndarray]
    frame_ids: Sequence[int]
    hands: HandSpace | None
    threads: int


@dataclasses.dataclass(frozen=True)
class StartSettings(ClipSettings):
    """What all providers are told.

    Attributes:
        provider: which.
        hands: take the fingers; else hands are flat.
        refine: fit the body to keypoints and masks from there; else the parameters are the result.
    """

    key: ClassVar[str]
    """Which setting names the user's file or folder."""

    provider: str
    hands: bool
    refine: bool

    def archive(self, footage: Footage) -> Archive:
        """The people.

        Raises:
            SoarError: what is brought cannot be used.
        """
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class ImportSettings(StartSettings):
    """Node ``body`` with the provider ``import``, besides the settings of the fit.

    Attributes:
        provider: ``import``.
        format: the tool that wrote the files, see :data:`soar.importers.registry.FORMATS`.
        source: file or folder.
        first_frame: number that the files give to the first frame of the recording; None for the tool's own habit.
        focal: focal length that the tool assumed, pixels, where its files do not say; None for the tool's own habit.
        image_size: width and height of the images the tool saw, where its files do not say; None for the frames' own.
    """

    key = "source"

    provider: Literal["import"]
    format: str
    source: str | None
    first_frame: int | None
    focal: float | None
    image_size: tuple[int, int] | None

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise ConfigError("unknown body.format", expected=", ".join(FORMATS), got=self.format)
        if not all(side > 0 for side in (self.focal or 1, *(self.image_size or ()))):
            raise ConfigError("body.focal and body.image_size must be positive")

    def archive(self, footage: Footage) -> Archive:
        """See :meth:`StartSettings.archive`."""
        (camera,) = footage.seen.cameras
        size = self.image_size or (camera.width, camera.height)
        found = read_parameters(self.format, footage.path, Known(size, self.focal, footage.hands))
        return found if self.first_frame is None else dataclasses.replace(found, first=self.first_frame)


@dataclasses.dataclass(frozen=True)
class NetworkSettings(StartSettings):
    """Node ``body`` with the provider ``regressor``, besides the settings of the fit.

    Attributes:
        provider: ``regressor``.
        network: ONNX file, see :mod:`soar.importers.pose_network`.
        device: where it runs.
        box_scale: factor on the box around the subject's keypoints, grown to the shape of the network's picture.
    """

    key = "network"

    provider: Literal["regressor"]
    network: str | None
    device: Literal["auto", "cpu", "cuda"]
    box_scale: float

    def archive(self, footage: Footage) -> Archive:
        """See :meth:`StartSettings.archive`."""
        network = PoseNetwork(footage.path, self.device, footage.threads)
        return network(footage.frames, footage.frame_ids, footage.seen, footage.hands, self.box_scale)


PROVIDERS: dict[str, type[StartSettings]] = {"import": ImportSettings, "regressor": NetworkSettings}


def split(node: Mapping[str, Any]) -> tuple[StartSettings | None, dict[str, Any]]:
    """The settings of the provider of a start, None where the fit finds its own, and the node of the fit.

    Args:
        node: the configuration node ``body``.

    Raises:
        ConfigError: an unknown, missing or ill-typed setting of the provider.
    """
    kind = PROVIDERS.get(node["provider"])
    if kind is None:
        return None, dict(node)
    own = {field.name for field in dataclasses.fields(kind)}
    start = settings(kind, {k: v for k, v in node.items() if k in own}, "body")
    return start, {k: v for k, v in node.items() if k not in own} | {"provider": "fit"}
