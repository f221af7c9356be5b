"""A network that estimates SMPL-X's parameters from a picture of one person, as SMPLer-X does, by contract.

Input ``image`` (1, 3, 512, 384): RGB in [0, 1], the person's box in it. Outputs, each with a leading axis of 1:
``root_pose`` (3), ``body_pose`` (63), ``left_hand_pose`` and ``right_hand_pose`` (45, from the mean hand), ``jaw_pose``
(3) as axis-angle in radians, ``betas`` (10), and ``cam_trans`` (3): the translation in metres, added last, in the axes
of a camera (x right, y down, z forward) that looks at the box with a focal length of 5000 pixels and the principal
point in its middle, the box being 192 x 256 pixels. More outputs, such as ``expression``, may follow; they are not
used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from soar.body.observations import Observations
from soar.body.parameters import HandSpace
from soar.errors import ModelFileError, SubjectError
from soar.importers.archive import Archive, Known, stacked
from soar.importers.smplerx import assembled
from soar.models.onnx import Signature, session
from soar.progress import track

_SIZE = (384, 512)  # width and height of the network's picture, pixels
_CAMERA = (192.0, 256.0, 5000.0)  # width, height and focal length of the camera it assumes, pixels
_OUTPUTS = {
    "root_pose": 3, "body_pose": 63, "left_hand_pose": 45, "right_hand_pose": 45, "jaw_pose": 3, "betas": 10,
    "cam_trans": 3,
}  # fmt: skip
_IN_FILES = {"root_pose": "global_orient", "cam_trans": "transl"}
SIGNATURE = Signature(
    inputs={"image": (1, 3, _SIZE[1], _SIZE[0])},
    outputs={name: (1, size) for name, size in _OUTPUTS.items()},
    others_may_follow=True,
)


@dataclasses.dataclass(frozen=True)
class Box:
    """A window of the image, of the network's shape: corner, width and height in pixels; it may leave the image."""

    x: float
    y: float
    width: float
    height: float

    @staticmethod
    def around(points: np.ndarray, size: tuple[int, int], scale: float) -> Box:
        """The box around points (N, 2) inside an image of ``size``, grown to the network's shape, times ``scale``."""
        low, high = (np.clip(corner, 0, size) for corner in (points.min(0), points.max(0)))
        aspect = _SIZE[0] / _SIZE[1]
        width, height = np.maximum(high - low, 1.0)
        width, height = scale * max(width, height * aspect), scale * max(height, width / aspect)
        x, y = (low + high) / 2 - np.array([width, height]) / 2
        return Box(float(x), float(y), float(width), float(height))

    def picture(self, image: np.ndarray) -> np.ndarray:
        """(1, 3, 512, 384) float32 in [0, 1] of an image (H, W, 3) uint8; black beyond it."""
        across, down = _SIZE[0] / self.width, _SIZE[1] / self.height
        crop_from_image = np.array([[across, 0, -across * self.x], [0, down, -down * self.y]])
        crop = cv2.warpAffine(image, crop_from_image, _SIZE, flags=cv2.INTER_LINEAR)
        return np.ascontiguousarray(crop.transpose(2, 0, 1)[None]).astype(np.float32) / np.float32(255)

    def intrinsics(self) -> np.ndarray:
        """(3, 3) of the camera that the network assumes, in pixels of the whole image."""
        width, height, focal = _CAMERA
        fx, fy = focal * self.width / width, focal * self.height / height
        return np.array([[fx, 0, self.x + self.width / 2], [0, fy, self.y + self.height / 2], [0, 0, 1.0]])


class PoseNetwork:
    """The network.

    Args:
        path: its file.
        device: auto, cpu or cuda.
        threads: of one inference.

    Raises:
        ModelFileError: it is missing, damaged, or of another signature.
        ConfigError: there is no such device.
    """

    def __init__(self, path: Path, device: str, threads: int) -> None:
        self.path, self._session = path, session(path, threads, SIGNATURE, device)

    def __call__(
        self,
        frames: Sequence[np.ndarray],
        frame_ids: Sequence[int],
        seen: Observations,
        hands: HandSpace | None,
        box_scale: float,
    ) -> Archive:
        """The subject in every frame in which the keypoints show them.

        Args:
            frames: (H, W, 3) uint8 RGB of the camera.
            frame_ids: their numbers.
            seen: keypoints of that one camera.
            hands: what fingers are measured in; None leaves hands out.
            box_scale: factor on the box around the keypoints, grown to the network's shape.

        Raises:
            SubjectError: the keypoints show nobody.
            ModelFileError: the network gives other shapes than it said, NaN or infinity.
        """
        (camera,) = seen.cameras
        size = (camera.width, camera.height)
        rows: dict[int, dict[str, np.ndarray]] = {}
        for t in track(range(len(seen)), "body network", len(seen)):
            points = seen.points[0, t][seen.confidence[0, t] > 0]
            if len(points):
                box = Box.around(points, size, box_scale)
                rows[frame_ids[t]] = self._row(box.picture(frames[t])) | {"K": box.intrinsics()}
        if not rows:
            raise SubjectError(
                f"camera {camera.name} never sees the subject", cure="look at the pictures of the keypoint stage"
            )
        return Archive((assembled(stacked(rows, self.path), Known(size, None, hands)),))

    def _row(self, picture: np.ndarray) -> dict[str, np.ndarray]:
        """One frame's outputs under the names of SMPLer-X's files; the eyes look straight ahead."""
        row = {"leye_pose": np.zeros(3), "reye_pose": np.zeros(3)}
        outputs = self._session.run(list(_OUTPUTS), {"image": picture})
        for (name, size), value in zip(_OUTPUTS.items(), outputs, strict=True):
            if value.shape != (1, size) or not np.isfinite(value).all():
                raise ModelFileError(
                    f"{self.path}: {name} is unusable", expected=f"finite {(1, size)}",
                    got=f"{value.shape}, {np.count_nonzero(~np.isfinite(value))} not finite",
                    cure="name a network made for this stage; docs/importers.md tells what it takes and gives",
                )  # fmt: skip
            row[_IN_FILES.get(name, name)] = value[0].astype(np.float64)
        return row
