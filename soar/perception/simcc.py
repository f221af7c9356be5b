"""Keypoints from whole-body networks with SimCC heads: RTMW, RTMPose and DWPose.

Such a network looks at a box around one person and says for every keypoint, of every half pixel column and row, how
likely it lies there (Li et al. 2022). It tells 133 keypoints, and nothing about depth or who the person is: boxes come
from a detector and are followed, metric landmarks come from BlazePose (:mod:`soar.perception.lift`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from soar.body import openpose
from soar.perception.brought import BroughtNetwork, brought_file, fits
from soar.perception.detector import POSE_SCALE, Person, PersonDetector
from soar.perception.following import Followed, FollowSettings, follow, follow_listed
from soar.perception.keypoints import Choice, Frames, Keypoints, TrackReport
from soar.perception.lift import LiftSettings, lift
from soar.perception.pose import Pose, PoseNetwork
from soar.perception.roi import Roi
from soar.perception.swaps import SwapSettings
from soar.perception.wholebody import WHOLEBODY, openpose_137
from soar.perception.yolox import Yolox, YoloxSettings
from soar.progress import track as progress

MEAN = np.array([123.675, 116.28, 103.53], np.float32)  # of RGB in [0, 255]
DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)


@dataclasses.dataclass(frozen=True)
class SimccSettings(FollowSettings):
    """Settings of :class:`SimccKeypoints`; see ``conf/keypoints/rtmw.yaml``."""

    provider: Literal["simcc"]
    network: str | None
    detector: str | None
    device: Literal["auto", "cpu", "cuda"]
    batch: int
    box_scale: float
    min_detection: float
    landmark_margin: float
    yolox: YoloxSettings
    mirrored: bool
    disagreement: float
    lift: LiftSettings
    swaps: SwapSettings


@dataclasses.dataclass(frozen=True)
class Crop:
    """What the network sees of a frame: ``scale`` frame pixels per pixel of its input, about a ``centre`` (2,)."""

    centre: np.ndarray
    scale: float

    def matrix(self, width: int, height: int) -> np.ndarray:
        """(2, 3) map from the input's pixels to the frame's, both counted from the centre of the first one."""
        shift = self.centre - self.scale * np.array([width, height]) / 2
        return np.column_stack([np.eye(2) * self.scale, shift])


def crop(box: np.ndarray, width: int, height: int, scale: float) -> Crop:
    """The crop of a box (4,) x0, y0, x1, y1, grown ``scale`` times and to the shape of the input."""
    size = (box[2:] - box[:2]) * scale
    return Crop((box[:2] + box[2:]) / 2, float(max(size[0] / width, size[1] / height)))


class SimccNetwork:
    """``input`` (N, 3, H, W); gives ``simcc_x`` (N, 133, s W) and ``simcc_y`` (N, 133, s H), s = 2.

    Args:
        path: the file.
        threads: threads of one inference.
        device: auto, cpu or cuda.

    Raises:
        ConfigError: there is no such device.
        ModelFileError: the file is missing, damaged, or no such network.
    """

    def __init__(self, path: Path, threads: int, device: str) -> None:
        self._network = BroughtNetwork(path, threads, device)
        self.batched, self.height, self.width = layout(self._network)

    def __call__(self, crops: np.ndarray) -> np.ndarray:
        """Keypoints (N, 133, 3), x and y in pixels of the input and confidence in [0, 1], of (N, H, W, 3) uint8 RGB."""
        tensor = ((crops - MEAN) / DEVIATION).transpose(0, 3, 1, 2)
        chunks = [tensor] if self.batched else tensor[:, None]
        return np.concatenate([self._run(chunk) for chunk in chunks])

    def _run(self, tensor: np.ndarray) -> np.ndarray:
        found = self._network({"input": tensor}, ("simcc_x", "simcc_y"))
        axes = [found[name].astype(np.float64) for name in ("simcc_x", "simcc_y")]
        ratios = [axis.shape[-1] / side for axis, side in zip(axes, (self.width, self.height), strict=True)]
        if any(axis.shape[:2] != (len(tensor), WHOLEBODY) for axis in axes) or ratios[0] != ratios[1] or ratios[0] < 1:
            raise self._network.misfit(_EXPECTED, f"it gave {axes[0].shape} and {axes[1].shape}")
        places = np.stack([axis.argmax(-1) for axis in axes], -1) / ratios[0]
        confidence = np.minimum(axes[0].max(-1), axes[1].max(-1)).clip(0, 1)
        return np.concatenate([places, confidence[..., None]], -1)


_EXPECTED = f"input (N, 3, H, W), H and W fixed; gives simcc_x (N, {WHOLEBODY}, 2 W) and simcc_y (N, {WHOLEBODY}, 2 H)"


def layout(network: BroughtNetwork) -> tuple[bool, int, int]:
    """Whether the network takes any number of crops at once, and the height and width of a crop.

    Raises:
        ModelFileError: it is no whole-body network with a SimCC head; those of the body alone have other counts.
    """
    picture, x, y = (side.get(name) for side, name in (
        (network.inputs, "input"), (network.outputs, "simcc_x"), (network.outputs, "simcc_y")))  # fmt: skip
    if picture is None or x is None or y is None or len(network.inputs) != 1 or not all(
        (fits((None, 3, None, None), picture), fits((None, WHOLEBODY, None), x), fits((None, WHOLEBODY, None), y))
    ):  # fmt: skip
        raise network.misfit(_EXPECTED)
    count, _, height, width = picture or (None,) * 4
    if height is None or width is None or count not in (None, 1):
        raise network.misfit(_EXPECTED)
    return count is None, height, width


class SimccKeypoints:
    """Estimate one subject's keypoints; implements :class:`~soar.perception.keypoints.KeypointProvider`.

    Args:
        settings: see the conf file.
        files: ``network`` and, if the boxes come from one, ``detector``; the folder ``models`` of our own networks.
        threads: threads of one inference.

    Raises:
        ConfigError: a path is not set, or there is no such device.
        ModelFileError: a network is missing, corrupt, or of another kind.
    """

    def __init__(self, settings: SimccSettings, files: Mapping[str, Path], threads: int) -> None:
        self._settings, models = settings, Path(files["models"])
        self._network = SimccNetwork(brought_file(files, "network", "keypoints"), threads, settings.device)
        self._pose = PoseNetwork(models / f"pose_landmark_{settings.lift.model}.onnx", threads)
        self._boxes: PersonDetector | Yolox
        if "detector" in files:
            self._boxes = Yolox(files["detector"], threads, settings.device, settings.yolox)
        else:
            self._boxes = PersonDetector(models / "pose_detection.onnx", threads, settings.min_detection)

    def __call__(self, frames: Frames, choice: Choice | None) -> tuple[Keypoints, TrackReport]:
        """See :meth:`soar.perception.keypoints.KeypointProvider.__call__`."""
        settings = self._settings
        followed, boxes = self._followed(frames, choice)
        passes = self._passes(frames, boxes)
        record, swapped, remarks = lift(
            frames, passes, followed.others, self._pose, settings.lift, settings.swaps, settings.disagreement
        )
        start, track = followed.start, followed.track
        remarks = [*followed.remarks, *remarks]
        return record, TrackReport(start.frame, start.rivalry, track.reacquired, swapped, tuple(remarks))

    def _followed(self, frames: Frames, choice: Choice | None) -> tuple[Followed, dict[int, np.ndarray]]:
        """The subject's track, and their box (4,) in every frame in which they were found."""
        height, width = frames[0].shape[:2]
        order = progress(range(len(frames)), "finding people")
        if isinstance(self._boxes, Yolox):
            found = [self._boxes(frames[t]) for t in order]
            people = [[Person(float(s), _around(box)) for box, s in zip(*each, strict=True)] for each in found]
            listed = follow_listed(people, (width, height), choice, self._settings)
            chosen = enumerate(listed.track.observations)
            return listed, {t: found[t][0][seen.index] for t, seen in chosen if seen is not None}

        def look(t: int, roi: Roi) -> Pose:
            return self._pose(frames[t], roi)

        detections = [self._boxes(frames[t]) for t in order]
        tracked = follow(detections, (width, height), choice, look, look, self._settings)
        margin = self._settings.landmark_margin
        return tracked, {
            t: _bounding(seen.points, margin) for t, seen in enumerate(tracked.track.observations) if seen is not None
        }

    def _passes(self, frames: Frames, boxes: Mapping[int, np.ndarray]) -> np.ndarray:
        """(P, T, 137, 3) keypoints in pixels of the frames of the direct pass and, if asked for, the mirrored one."""
        network = self._network
        result = np.zeros((1 + self._settings.mirrored, len(frames), openpose.COUNT, 3))
        for batch in progress(list(_batches(sorted(boxes), self._settings.batch)), "keypoints"):
            crops = [crop(boxes[t], network.width, network.height, self._settings.box_scale) for t in batch]
            matrices = np.stack([c.matrix(network.width, network.height) for c in crops])
            seen = np.stack([_sampled(frames[t], m, self._size) for t, m in zip(batch, matrices, strict=True)])
            result[0, batch] = _placed(openpose_137(network(seen)), matrices)
            if self._settings.mirrored:
                found = openpose_137(network(np.ascontiguousarray(seen[:, :, ::-1])))
                found[..., 0] = network.width - 1 - found[..., 0]
                result[1, batch] = _placed(found[:, openpose.mirror()], matrices)
        return result

    @property
    def _size(self) -> tuple[int, int]:
        return self._network.width, self._network.height


def _batches(frames: Sequence[int], size: int) -> Iterator[list[int]]:
    return (list(frames[i : i + size]) for i in range(0, len(frames), size))


def _sampled(image: np.ndarray, matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) uint8: the part of a frame that the network is shown, black beyond the frame."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_CONSTANT)


def _placed(keypoints: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Keypoints (N, 137, 3) of crops in pixels of their frames, whose first pixel's centre is at 0.5."""
    places = keypoints[..., :2] @ matrices[:, :, :2].transpose(0, 2, 1) + matrices[:, None, :, 2] + 0.5
    return np.concatenate([places, keypoints[..., 2:]], -1)


def _around(box: np.ndarray) -> Roi:
    """The upright region round a box (4,)."""
    x0, y0, x1, y1 = map(float, box)
    return Roi((x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0) * POSE_SCALE, 0.0)


def _bounding(points: np.ndarray, margin: float) -> np.ndarray:
    """(4,) box round landmarks (33, 2), grown on all sides by ``margin`` of its longer side."""
    low, high = points.min(0), points.max(0)
    grow = margin * (high - low).max()
    return np.concatenate([low - grow, high + grow])
