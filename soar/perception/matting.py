"""Masks by any network from one picture to one map of the person, described in the configuration."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from soar.errors import ConfigError
from soar.perception.brought import Axes, BroughtNetwork, brought_file, fits
from soar.perception.region import RegionSettings, resized, subject_mask
from soar.perception.roi import Roi
from soar.perception.ssd import sigmoid

_SLACK = 0.01  # by which a network may leave [0, 1], such as by half precision


@dataclasses.dataclass(frozen=True)
class FreeSize:
    """An input of the picture's shape: its ``side`` (the longer or the shorter) is brought to ``pixels``, then both
    sides are rounded to multiples of ``multiple_of``.
    """

    side: Literal["long", "short"]
    pixels: int
    multiple_of: int


@dataclasses.dataclass(frozen=True)
class MinMax:
    """The map is rescaled so that it spans 0 to 1, unless its largest value is below ``minmax_above``: then nobody is
    there, and rescaling would make a person of noise.
    """

    minmax_above: float


@dataclasses.dataclass(frozen=True)
class NetworkSettings:
    """The description of a network, and where it looks; see ``conf/masks/network.yaml``."""

    provider: Literal["network"]
    network: str | None
    device: Literal["auto", "cpu", "cuda"]
    input: str | None
    size: tuple[int, int] | FreeSize
    resize: Literal["stretch", "letterbox"]
    layout: Literal["nchw", "nhwc"]
    colours: Literal["rgb", "bgr"]
    divide_by: float | Literal["maximum"]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    output: str | int
    activation: Literal["none", "sigmoid", "softmax"] | MinMax
    channels: tuple[int, ...]
    states: dict[str, str]
    constants: dict[str, tuple[float, ...]]
    region: RegionSettings


class NetworkMasks:
    """Masks by the network that ``settings`` describe; implements :class:`soar.perception.masks.MaskProvider`.

    A network with states is shown the frames in order; its states start at zero and pass from one frame to the next.

    Args:
        settings: see the conf file.
        brought: path of ``network``.
        threads: threads of one inference.

    Raises:
        ConfigError: no path is set, or the description contradicts itself.
        ModelFileError: the file is missing, no network, or not the one described.
    """

    def __init__(self, settings: NetworkSettings, brought: Mapping[str, Path], threads: int) -> None:
        _check_description(settings)
        self._settings = settings
        self._network = BroughtNetwork(brought_file(brought, "network", "masks"), threads, settings.device)
        self._picture, self._output = matched(settings, self._network)
        self._states = {name: _start(self._network.inputs[name]) for name in settings.states}

    def __call__(self, image: np.ndarray, roi: Roi, body: np.ndarray) -> np.ndarray:
        """See :meth:`soar.perception.masks.MaskProvider.__call__`."""
        return subject_mask(self._window, self._settings.region, image, roi, body)

    def _window(self, image: np.ndarray, body: np.ndarray) -> np.ndarray:
        settings = self._settings
        height, width = image.shape[:2]
        size = _size(settings.size, height, width)
        covered = size if settings.resize == "stretch" else _within(size, height, width)
        y, x = ((whole - part) // 2 for whole, part in zip(size, covered, strict=True))
        picture = np.zeros((*size, 3), np.float32)
        picture[y : y + covered[0], x : x + covered[1]] = _normalised(settings, resized(image, *covered))
        found = self._run(picture if settings.layout == "nhwc" else picture.transpose(2, 0, 1))
        alpha = resized(self._alpha(self._planes(found)), *size)  # it may be coarser than what the network was shown
        return resized(alpha[y : y + covered[0], x : x + covered[1]], height, width)

    def _run(self, picture: np.ndarray) -> np.ndarray:
        settings = self._settings
        feed = {self._picture: picture[None], **self._states}
        feed |= {name: np.array(values) for name, values in settings.constants.items()}
        found = self._network(feed, dict.fromkeys((self._output, *settings.states.values())))
        self._states = {name: found[output] for name, output in settings.states.items()}
        return found[self._output]

    def _planes(self, found: np.ndarray) -> np.ndarray:
        """The output as (C, h, w)."""
        while found.ndim > 3 and found.shape[0] == 1:
            found = found[0]
        if found.ndim == 3 and self._settings.layout == "nhwc" and found.shape[0] != 1:
            found = found.transpose(2, 0, 1)
        if found.ndim == 2:
            found = found[None]
        if found.ndim != 3 or max(self._settings.channels) >= len(found):
            raise self._network.misfit(
                f"an output {self._output} with a map of the person in channel {self._settings.channels}",
                f"it gave {found.shape}",
            )
        return found

    def _alpha(self, planes: np.ndarray) -> np.ndarray:
        """Alpha (h, w) of the output (C, h, w)."""
        activation, channels = self._settings.activation, list(self._settings.channels)
        if isinstance(activation, MinMax):
            values = planes[channels].sum(0)
            low, high = float(values.min()), float(values.max())
            if high < activation.minmax_above or high <= low:
                return np.zeros_like(values)
            return (values - low) / (high - low)
        self._check_range(planes, channels, activation)
        if activation == "softmax":
            weights = np.exp(planes - planes.max(0))
            return weights[channels].sum(0) / weights.sum(0)
        chosen = planes[channels]
        return (sigmoid(chosen) if activation == "sigmoid" else chosen).sum(0).clip(0, 1).astype(np.float32)

    def _check_range(self, planes: np.ndarray, channels: list[int], activation: str) -> None:
        """Alpha that is taken for logits, or logits for alpha, would be a mask that is wrong but looks like one."""
        seen = planes if activation == "softmax" else planes[channels]
        low, high = float(seen.min()), float(seen.max())
        alpha = low >= -_SLACK and high <= 1 + _SLACK
        if activation == "softmax":
            alpha = alpha and np.abs(planes.sum(0) - 1).max() <= _SLACK
        if alpha != (activation == "none"):
            raise self._network.misfit(
                "alpha from 0 to 1" if activation == "none" else f"numbers that {activation} makes alpha of",
                f"{self._output} gave {low:.3g} to {high:.3g}: correct masks.activation",
            )


def _check_description(settings: NetworkSettings) -> None:
    if settings.states and settings.region.margin is not None:
        raise ConfigError(
            "masks.region.margin: a network with states needs the whole frame, for its states are pictures too",
            expected="null",
            got=str(settings.region.margin),
        )
    if not settings.channels or min(settings.channels) < 0:
        raise ConfigError("masks.channels", expected="numbers of channels, from 0", got=str(settings.channels))
    if min(settings.std) <= 0 or (settings.divide_by != "maximum" and settings.divide_by <= 0):
        raise ConfigError(
            "masks.std, masks.divide_by", expected="positive", got=f"{settings.std}, {settings.divide_by}"
        )


def matched(settings: NetworkSettings, network: BroughtNetwork) -> tuple[str, str]:
    """Names of the input for the picture and of the output for the person.

    Raises:
        ModelFileError: the file has other inputs or outputs than described.
    """
    size, inputs, outputs = settings.size, network.inputs, list(network.outputs)
    sides: Axes = (None, None) if isinstance(size, FreeSize) else size
    picture = (1, 3, *sides) if settings.layout == "nchw" else (1, *sides, 3)
    others = [*settings.states, *settings.constants]
    free = [name for name in inputs if name not in others]
    named = [settings.input] if settings.input is not None else free
    place = settings.output
    output = place if isinstance(place, str) else (dict(enumerate(outputs)).get(place, ""))
    right = (
        len(free) == 1
        and free == named
        and fits(picture, inputs[free[0]])
        and not (isinstance(size, FreeSize) and any(inputs[free[0]][axis] for axis in _sides(settings)))
        and set(others) <= inputs.keys()
        and {output, *settings.states.values()} <= network.outputs.keys()
    )
    if not right:
        axes = ", ".join("free" if axis is None else str(axis) for axis in picture)
        raise network.misfit(
            f"a picture {settings.input or 'of any name'} [{axes}]"
            + "".join(f", {name}" for name in others)
            + f"; output {place}"
            + "".join(f", {name}" for name in settings.states.values())
        )
    return free[0], output


def _sides(settings: NetworkSettings) -> tuple[int, int]:
    """Axes of height and width."""
    return (2, 3) if settings.layout == "nchw" else (1, 2)


def _start(axes: Axes) -> np.ndarray:
    """A state before the first frame."""
    return np.zeros([axis or 1 for axis in axes], np.float32)


def _size(size: tuple[int, int] | FreeSize, height: int, width: int) -> tuple[int, int]:
    """Height and width of the input for a window of ``height`` x ``width``."""
    if not isinstance(size, FreeSize):
        return size
    scale = size.pixels / (max if size.side == "long" else min)(height, width)
    rows, columns = (size.multiple_of * max(1, round(s * scale / size.multiple_of)) for s in (height, width))
    return rows, columns


def _within(size: tuple[int, int], height: int, width: int) -> tuple[int, int]:
    """The largest size of the shape of ``height`` x ``width`` that fits into ``size``."""
    scale = min(size[0] / height, size[1] / width)
    return max(1, round(height * scale)), max(1, round(width * scale))


def _normalised(settings: NetworkSettings, picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 of uint8 RGB, as the network takes it."""
    values = picture.astype(np.float32)
    values /= max(float(values.max()), 1.0) if settings.divide_by == "maximum" else settings.divide_by
    if settings.colours == "bgr":
        values = values[..., ::-1]
    return (values - np.float32(settings.mean)) / np.float32(settings.std)
