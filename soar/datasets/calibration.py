"""The calibration file of a multi-camera capture, checked field by field. Its schema is in ``docs/data.md``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from itertools import combinations
from typing import Any, Literal

import numpy as np

from soar.datasets.recordings import Probe
from soar.datasets.sequence import unit_up
from soar.errors import CalibrationError
from soar.geometry.cameras import Camera

SizeMismatch = Literal["error", "crop", "resize"]

_KEYS = {"units", "up", "fps", "pixel_centre", "cameras"}
_CAMERA_KEYS = {"size", "K", "distortion", "T_cam_from_world", "source"}
_FARTHEST = 200.0  # metres between two cameras that see one person


@dataclasses.dataclass(frozen=True)
class Calibration:
    """A capture's cameras, the up axis and, where stated, the frame rate; ``remarks`` say what was assumed."""

    cameras: Mapping[str, Camera]
    up: np.ndarray
    fps: float | None
    remarks: tuple[str, ...]


def parse_calibration(value: Any, where: str) -> Calibration:
    """Read the calibration schema.

    Args:
        value: the parsed JSON.
        where: the file's name, for messages.

    Raises:
        CalibrationError: naming the camera and the field that is missing, unknown or malformed.
    """
    _check_keys(value, _KEYS, {"cameras"}, where)
    if value.get("units", "metres") != "metres":
        raise CalibrationError(
            f"{where}: units must be metres",
            got=repr(value["units"]),
            cure="divide the translations, say units: metres",
        )
    pixel_centre, fps = value.get("pixel_centre", 0.5), value.get("fps")
    if pixel_centre not in (0, 0.5):
        raise CalibrationError(f"{where}: pixel_centre", expected="0 (OpenCV) or 0.5", got=repr(pixel_centre))
    if fps is not None and not (_is_number(fps) and np.isfinite(fps) and fps > 0):
        raise CalibrationError(f"{where}: fps", expected="frames per second, positive", got=repr(fps))
    if not isinstance(value["cameras"], Mapping) or not value["cameras"]:
        raise CalibrationError(f"{where}: cameras", expected="a mapping from camera name to its parameters")
    if unusable := [name for name in value["cameras"] if not re.fullmatch(r"[A-Za-z0-9_-]+", str(name))]:
        raise CalibrationError(f"{where}: camera names", expected="letters, digits, _ and -", got=repr(unusable))
    cameras = {
        str(name): _camera(str(name), entry, 0.5 - pixel_centre, where) for name, entry in value["cameras"].items()
    }
    for a, b in combinations(cameras.values(), 2):
        distance = np.linalg.norm(a.centre - b.centre)
        if distance > _FARTHEST:
            raise CalibrationError(
                f"{where}: cameras {a.name} and {b.name} are {distance:.0f} m apart",
                expected=f"at most {_FARTHEST:.0f} m",
                cure="give translations in metres, not millimetres",
            )
    remarks = () if "up" in value else (f"{where} names no up axis; the world's z axis is taken.",)
    return Calibration(cameras, unit_up(value.get("up", [0, 0, 1]), where), fps, remarks)


def intrinsic_matrix(value: Any, where: str) -> np.ndarray:
    """(3, 3) intrinsics from ``[fx, fy, cx, cy]`` or three rows, pixels.

    Raises:
        CalibrationError: another form, or entries that are not finite.
    """
    K = _array(value, where, "K", (4,), (3, 3))
    if K.shape == (4,):
        fx, fy, cx, cy = K
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    if not np.array_equal(K[2], (0, 0, 1)) or K[0, 1] != 0 or K[1, 0] != 0:
        raise CalibrationError(f"{where}: K", expected="[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", got=str(K.tolist()))
    return K


def distortion_vector(value: Any, where: str) -> np.ndarray:
    """(5,) OpenCV distortion k1 k2 p1 p2 k3 from four or five numbers."""
    return np.pad(d := _array(value, where, "distortion", (4,), (5,)), (0, 5 - d.size))


def match_size(camera: Camera, probe: Probe, policy: SizeMismatch) -> tuple[Camera, str | None]:
    """Adapt a calibrated camera to the frames that were recorded.

    Args:
        camera: as calibrated.
        probe: the recording.
        policy: what to do with frames of another size: ``error``; ``crop``, the frames are the calibrated image
            without some columns on the right or rows at the bottom (K is kept); ``resize``, the frames are the whole
            calibrated image resampled (K is scaled).

    Returns:
        the camera of the recorded frames, and a remark when they differ from the calibrated ones.

    Raises:
        CalibrationError: the sizes differ in a way the policy does not allow.
    """
    size, calibrated = (probe.width, probe.height), (camera.width, camera.height)
    if size == calibrated:
        return camera, None
    text = f"Camera {camera.name}: frames are {size[0]}x{size[1]}, calibrated for {calibrated[0]}x{calibrated[1]}"
    if policy == "crop" and size[0] <= calibrated[0] and size[1] <= calibrated[1]:
        return dataclasses.replace(camera, width=size[0], height=size[1]), f"{text}; taken as cropped, K kept."
    # Half a pixel of rounding on either side is no change of shape.
    same_shape = abs(size[0] * calibrated[1] - size[1] * calibrated[0]) <= max(calibrated)
    if policy == "resize" and same_shape:
        return camera.resized(*size), f"{text}; K scaled."
    raise CalibrationError(
        text,
        expected={
            "error": "equal sizes",
            "crop": "frames no larger than calibrated",
            "resize": "the same aspect ratio",
        }[policy],
        cure="record at the calibrated size, or set dataset.size_mismatch to crop or resize if that is what happened",
    )


def _camera(name: str, entry: Any, shift: float, file: str) -> Camera:
    where = f"{file}: camera {name}"
    _check_keys(entry, _CAMERA_KEYS, {"size", "K", "T_cam_from_world"}, where)
    width, height = _array(entry["size"], where, "size", (2,))
    if width % 1 or height % 1 or min(width, height) < 1:
        raise CalibrationError(f"{where}: size", expected="whole pixels, at least 1", got=repr(entry["size"]))
    transform = _array(entry["T_cam_from_world"], where, "T_cam_from_world", (4, 4))
    if not np.array_equal(transform[3], (0, 0, 0, 1)):
        raise CalibrationError(
            f"{where}: T_cam_from_world", expected="last row 0 0 0 1", got=str(transform[3].tolist())
        )
    K = intrinsic_matrix(entry["K"], where)
    K[:2, 2] += shift
    return Camera(
        name=name,
        width=int(width),
        height=int(height),
        K=K,
        T_cam_from_world=transform,
        distortion=distortion_vector(entry.get("distortion", [0, 0, 0, 0, 0]), where),
        K_source=f"calibration ({file})",
    )


def _check_keys(value: Any, known: set[str], required: set[str], where: str) -> None:
    if not isinstance(value, Mapping):
        raise CalibrationError(f"{where} is not a mapping", got=repr(value)[:80])
    unknown, missing = sorted(set(value) - known), sorted(required - set(value))
    if unknown or missing:
        raise CalibrationError(
            f"{where} does not fit the schema",
            expected=", ".join(sorted(known)),
            got=", ".join([*(f"unknown {k}" for k in unknown), *(f"missing {k}" for k in missing)]),
            cure="see docs/data.md",
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _array(value: Any, where: str, field: str, *shapes: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        array = np.full(0, np.nan)
    if array.shape not in shapes or not np.isfinite(array).all():
        wanted = " or ".join("x".join(map(str, shape)) for shape in shapes)
        raise CalibrationError(f"{where}: {field}", expected=f"{wanted} finite numbers", got=repr(value)[:200])
    return array
