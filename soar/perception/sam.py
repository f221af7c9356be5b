"""Masks by Segment Anything: SAM, MobileSAM and SAM 2 as pairs of ONNX files, prompted with keypoints and their box."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from soar.errors import ModelFileError
from soar.perception.brought import Axes, BroughtNetwork, brought_file, fits
from soar.perception.region import RegionSettings, resized, subject_mask
from soar.perception.roi import Roi
from soar.perception.ssd import sigmoid

SIDE = 1024  # pixels of the encoder's square, where the file does not say
MEAN, STD = np.float32([123.675, 116.28, 103.53]), np.float32([58.395, 57.12, 57.375])  # of ImageNet, 0 to 255
POSITIVE, TOP_LEFT, BOTTOM_RIGHT = 1, 2, 3  # labels of prompts


@dataclasses.dataclass(frozen=True)
class Scheme:
    """How an export names what the decoder takes besides ``point_coords`` and ``point_labels``.

    Attributes:
        name: of the family, in words.
        features: what the encoder gives.
        mask, has_mask: an earlier mask, and whether there is one.
        size: height and width of the masks wanted; some exports of SAM 2 do without.
        stretched: the picture fills the encoder's square; otherwise its longer side does.
    """

    name: str
    features: tuple[str, ...]
    mask: str
    has_mask: str
    size: str
    stretched: bool

    @property
    def inputs(self) -> frozenset[str]:
        """What a decoder of this scheme takes, less ``size``."""
        return frozenset({*self.features, "point_coords", "point_labels", self.mask, self.has_mask})


SCHEMES = (
    Scheme("SAM, MobileSAM", ("image_embeddings",), "mask_input", "has_mask_input", "orig_im_size", False),
    Scheme(
        "SAM 2 of samexporter", ("image_embed", "high_res_feats_0", "high_res_feats_1"),
        "mask_input", "has_mask_input", "orig_im_size", True,
    ),
    Scheme(
        "SAM 2 of onnxruntime", ("image_embeddings", "image_features_0", "image_features_1"),
        "input_masks", "has_input_masks", "original_image_size", True,
    ),
)  # fmt: skip
_RANKS = {"point_coords": 3, "point_labels": 2, "masks": 4, "iou_predictions": 2}


@dataclasses.dataclass(frozen=True)
class SamSettings:
    """Settings of :class:`SamMasks`; see ``conf/masks/sam.yaml``."""

    provider: Literal["sam"]
    encoder: str | None
    decoder: str | None
    device: Literal["auto", "cpu", "cuda"]
    min_prompt_confidence: float
    box_margin: float
    region: RegionSettings


@dataclasses.dataclass(frozen=True)
class Canvas:
    """What the encoder was shown.

    Attributes:
        tensor: its input.
        size: height and width of the part that counts as a picture to the decoder, in the units of prompts.
        covered: height and width of the part of it, from the top left, that the window fills.
    """

    tensor: np.ndarray
    size: tuple[int, int]
    covered: tuple[int, int]


class SamMasks:
    """Masks of one subject from an encoder and a decoder; implements :class:`soar.perception.masks.MaskProvider`.

    Trusted body keypoints are positive points, the box around them is the box. Of the masks that the decoder offers,
    the one is taken for which predicted IoU, share of the points held and share of its area within the box have the
    largest product. Alpha is the logistic function of its logits, enlarged bilinearly.

    Args:
        settings: see the conf file.
        brought: paths of ``encoder`` and ``decoder``.
        threads: threads of one inference.

    Raises:
        ConfigError: a path is not set.
        ModelFileError: a file is missing or no network, or the two are no pair of one of :data:`SCHEMES`.
    """

    def __init__(self, settings: SamSettings, brought: Mapping[str, Path], threads: int) -> None:
        self._settings = settings
        self._encoder, self._decoder = (
            BroughtNetwork(brought_file(brought, key, "masks"), threads, settings.device)
            for key in ("encoder", "decoder")
        )
        self._scheme = _scheme(self._encoder, self._decoder)
        self._given = _given(self._scheme, self._encoder)
        [(self._input, self._axes)] = self._encoder.inputs.items()

    def __call__(self, image: np.ndarray, roi: Roi, body: np.ndarray) -> np.ndarray:
        """See :meth:`soar.perception.masks.MaskProvider.__call__`."""
        return subject_mask(self._window, self._settings.region, image, roi, body)

    def _window(self, image: np.ndarray, body: np.ndarray) -> np.ndarray:
        height, width = image.shape[:2]
        points = body[body[:, 2] >= self._settings.min_prompt_confidence, :2]
        points = points[((points >= 0) & (points < (width, height))).all(1)]
        if not len(points):
            return np.zeros((height, width), np.float32)
        box = _box(points, self._settings.box_margin, width, height)
        canvas = self._canvas(image)
        logits, quality = self._decode(canvas, points, box, (height, width))
        return _chosen(logits, quality, points, box, (height, width))

    def _canvas(self, image: np.ndarray) -> Canvas:
        if len(self._axes) == 3:
            return with_own_preprocessing(image, self._axes)
        side = self._axes[2] or SIDE
        return (stretched if self._scheme.stretched else padded)(image, side)

    def _decode(
        self, canvas: Canvas, points: np.ndarray, box: np.ndarray, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logits (M, h, w) of the masks on the window, at any resolution, and their predicted IoU (M,)."""
        scheme, decoder = self._scheme, self._decoder
        seen = self._encoder({self._input: canvas.tensor}, self._given)
        features = dict(zip(scheme.features, seen.values(), strict=True))
        scale = np.array(canvas.covered[::-1]) / shape[::-1]
        labels = [POSITIVE] * len(points) + [TOP_LEFT, BOTTOM_RIGHT]
        height, width = (4 * side for side in features[scheme.features[0]].shape[2:])
        feed = features | {
            "point_coords": (np.concatenate([points, box]) * scale)[None],
            "point_labels": np.array(labels)[None],
            scheme.mask: np.zeros((1, 1, height, width)),
            scheme.has_mask: np.zeros((1,) * len(decoder.inputs[scheme.has_mask])),
            scheme.size: np.array(canvas.size),
        }
        found = decoder({name: feed[name] for name in decoder.inputs}, ("masks", "iou_predictions"))
        masks = found["masks"][0]
        rows, columns = (
            max(1, round(have * part / whole))
            for have, part, whole in zip(masks.shape[1:], canvas.covered, canvas.size, strict=True)
        )
        return masks[:, :rows, :columns], found["iou_predictions"][0]


def padded(image: np.ndarray, side: int) -> Canvas:
    """SAM's input (1, 3, side, side): the picture's longer side made ``side``, normalised, then padded with zero."""
    small = _fitted(image, side, side)
    height, width = small.shape[:2]
    tensor = np.zeros((1, 3, side, side), np.float32)
    tensor[0, :, :height, :width] = ((small - MEAN) / STD).transpose(2, 0, 1)
    return Canvas(tensor, (height, width), (height, width))


def with_own_preprocessing(image: np.ndarray, axes: tuple[int | None, ...]) -> Canvas:
    """Input (h, w, 3) in [0, 255] of an encoder that normalises and pads by itself; black beyond the picture where the
    file fixes h and w.
    """
    small = _fitted(image, axes[0] or SIDE, axes[1] or SIDE)
    covered = small.shape[:2]
    height, width = axes[0] or covered[0], axes[1] or covered[1]
    tensor = np.zeros((height, width, 3), np.float32)
    tensor[: covered[0], : covered[1]] = small
    return Canvas(tensor, (height, width), covered)


def stretched(image: np.ndarray, side: int) -> Canvas:
    """The input of SAM 2: (1, 3, side, side), the picture stretched to the square and normalised."""
    small = resized(image, side, side)
    tensor = ((small - MEAN) / STD).transpose(2, 0, 1)[None]
    return Canvas(tensor, (side, side), (side, side))


def _fitted(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The picture at the largest size that fits into ``height`` x ``width``."""
    scale = min(height / image.shape[0], width / image.shape[1])
    return resized(image, *(max(1, int(side * scale + 0.5)) for side in image.shape[:2]))


def _box(points: np.ndarray, margin: float, width: int, height: int) -> np.ndarray:
    """(2, 2) corners, top left first, of the box around points (N, 2), grown by ``margin`` of its longer side."""
    low, high = points.min(0), points.max(0)
    grown = margin * max(high - low)
    return np.clip([low - grown, high + grown], 0, (width, height))


def _chosen(
    logits: np.ndarray, quality: np.ndarray, points: np.ndarray, box: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Alpha (H, W) of the best of the masks (M, h, w); zero where none agrees with the prompts."""
    scale = np.array(logits.shape[:0:-1]) / shape[::-1]
    inside = logits > 0
    columns, rows = np.floor(points * scale).astype(int).T
    held = inside[:, rows, columns].mean(1)
    (x0, y0), (x1, y1) = np.round(box * scale).astype(int)
    area = inside.sum((1, 2))
    within = inside[:, y0:y1, x0:x1].sum((1, 2)) / np.maximum(area, 1)
    score = quality.clip(0) * held * within
    best = int(np.argmax(score))
    if score[best] <= 0:
        return np.zeros(shape, np.float32)
    return sigmoid(cv2.resize(logits[best], shape[::-1], interpolation=cv2.INTER_LINEAR)).astype(np.float32)


def _given(scheme: Scheme, encoder: BroughtNetwork) -> tuple[str, ...]:
    """Names of the encoder's outputs, as the features of the scheme; a single one may have any name."""
    return scheme.features if len(scheme.features) > 1 else tuple(encoder.outputs)


def _scheme(encoder: BroughtNetwork, decoder: BroughtNetwork) -> Scheme:
    """The scheme of a pair of files.

    Raises:
        ModelFileError: they are none, or not of one another.
    """
    for scheme in SCHEMES:
        if is_decoder(scheme, decoder) and is_encoder(scheme, encoder, decoder):
            return scheme
    raise ModelFileError(
        f"{encoder.path} and {decoder.path} are no encoder and decoder that belong together",
        expected="; or ".join(
            f"{scheme.name}: an encoder from a picture to {', '.join(scheme.features)}, a decoder from "
            f"{', '.join(sorted(scheme.inputs))}, {scheme.size} to masks, iou_predictions"
            for scheme in SCHEMES
        ),
        got=f"an encoder that {encoder.signature}; a decoder that {decoder.signature}",
        cure="name files of one export, encoder and decoder in this order",
    )


def is_decoder(scheme: Scheme, decoder: BroughtNetwork) -> bool:
    """Whether a network takes and gives what a decoder of this scheme does, by name and number of axes."""
    tensors = decoder.inputs | decoder.outputs
    return decoder.inputs.keys() - {scheme.size} == scheme.inputs and all(
        name in tensors and len(tensors[name]) in (0, rank) for name, rank in _RANKS.items()
    )


def is_encoder(scheme: Scheme, encoder: BroughtNetwork, decoder: BroughtNetwork) -> bool:
    """Whether a network takes a picture as this scheme does, and gives what its decoder takes."""
    given, taken = _given(scheme, encoder), [decoder.inputs[name] for name in scheme.features]
    return (
        [_takes_picture(scheme, axes) for axes in encoder.inputs.values()] == [True]
        and encoder.outputs.keys() == set(given)
        and len(given) == len(taken)
        and all(fits(axes, encoder.outputs[name]) for name, axes in zip(given, taken, strict=True))
    )


def _takes_picture(scheme: Scheme, axes: Axes) -> bool:
    return (not scheme.stretched and fits((None, None, 3), axes)) or (
        fits((1, 3, None, None), axes) and axes[2] == axes[3]
    )
