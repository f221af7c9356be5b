"""What the cameras saw of one person, stacked: the input of triangulation, camera refinement and fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from soar.body.openpose import BODY, COUNT, LIMBS
from soar.errors import CalibrationError, SubjectError
from soar.geometry.cameras import Camera


@dataclasses.dataclass(frozen=True)
class Observations:
    """Keypoints of C cameras over T common frames.

    Attributes:
        cameras: C calibrated cameras of undistorted frames.
        points: (C, T, 137, 2) pixels.
        confidence: (C, T, 137) in [0, 1]; 0 where nothing was seen.
        world: (C, T, 25, 3) metric points of BODY_25 about the middle of the hips, metres, axes of an upright image: x
            right, y down, z away; NaN where there are none.
    """

    cameras: tuple[Camera, ...]
    points: np.ndarray
    confidence: np.ndarray
    world: np.ndarray

    @staticmethod
    def gather(
        cameras: Sequence[Camera], keypoints: Sequence[np.ndarray], world: Sequence[np.ndarray], min_confidence: float
    ) -> Observations:
        """Stack the cameras' keypoints (T, 137, 3); a confidence below ``min_confidence`` counts as not seen.

        Raises:
            CalibrationError: cameras with different numbers of frames.
            SubjectError: a clip without frames, or one in which no camera sees the person's limbs.
        """
        lengths = {camera.name: len(k) for camera, k in zip(cameras, keypoints, strict=True)}
        if len(set(lengths.values())) != 1:
            raise CalibrationError(
                "the cameras have different numbers of frames", expected="equal", got=str(lengths),
                cure="check the synchronisation of the recordings",
            )  # fmt: skip
        stacked = np.stack([np.asarray(k, np.float64) for k in keypoints])
        if stacked.shape[1] == 0 or stacked.shape[2:] != (COUNT, 3):
            raise SubjectError(
                "there are no frames with keypoints", expected=f"(T, {COUNT}, 3), T > 0", got=str(stacked.shape[1:])
            )
        confidence = stacked[..., 2].clip(0, 1)
        confidence[~np.isfinite(stacked).all(-1) | (confidence < min_confidence)] = 0
        seen = (confidence[:, :, list(LIMBS)] > 0).sum(-1)
        if seen.max() < 4:
            raise SubjectError(
                "the person is not seen well enough in any frame",
                expected=f"4 of the 12 limb joints with a confidence of {min_confidence} or more",
                got=f"at most {seen.max()}",
                cure="look at the pictures of the keypoint stage; give subject.box or lower body.min_confidence",
            )
        return Observations(tuple(cameras), np.nan_to_num(stacked[..., :2]), confidence, np.stack(world))

    def __len__(self) -> int:
        return self.points.shape[1]

    def select(self, names: Sequence[str]) -> Observations:
        """Only the cameras called ``names``, in that order."""
        at = {camera.name: i for i, camera in enumerate(self.cameras)}
        index = [at[name] for name in names]
        return Observations(
            tuple(self.cameras[i] for i in index), self.points[index], self.confidence[index], self.world[index]
        )

    def box_height(self) -> np.ndarray:
        """(C, T) longer side of the box around the confident body points, pixels: the unit of residuals.

        Frames in which fewer than half of the limb joints are seen take the camera's median; a camera that never sees
        them takes its image height.
        """
        body = slice(0, len(BODY))
        seen = self.confidence[:, :, body, None] > 0
        low = np.where(seen, self.points[:, :, body], np.inf).min(2)
        high = np.where(seen, self.points[:, :, body], -np.inf).max(2)
        usable = (self.confidence[:, :, list(LIMBS)] > 0).sum(-1) * 2 >= len(LIMBS)
        size = np.full(usable.shape, np.nan)
        size[usable] = (high - low).max(-1)[usable]
        for c, camera in enumerate(self.cameras):
            size[c, ~usable[c]] = np.median(size[c, usable[c]]) if usable[c].any() else camera.height
        return size
