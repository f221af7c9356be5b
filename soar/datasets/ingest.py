"""From a capture to the record and the frames later stages work on: choose, undistort, resample, frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import cv2
import numpy as np

from soar.datasets.capture import Capture
from soar.datasets.selection import FrameSettings
from soar.datasets.sequence import Sequence, Source, Subject
from soar.errors import ConfigError, InputError, SubjectError
from soar.geometry.cameras import Camera


class Undistortion:
    """Removes a camera's lens distortion, keeping K and size; places the lens did not see are black."""

    def __init__(self, camera: Camera) -> None:
        self._maps = None
        if camera.distortion.any():
            K, size = opencv_intrinsics(camera.K), (camera.width, camera.height)
            self._maps = cv2.initUndistortRectifyMap(K, camera.distortion, None, K, size, cv2.CV_16SC2)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 to (H, W, 3) uint8."""
        # Bilinear: at half resolution it blurs as little as bicubic overshoots, at a quarter of the time.
        return image if self._maps is None else cv2.remap(image, *self._maps, cv2.INTER_LINEAR)


def opencv_intrinsics(K: np.ndarray) -> np.ndarray:
    """(3, 3) intrinsics for OpenCV, which counts the centre of the top-left pixel as (0, 0), not (0.5, 0.5)."""
    shifted = K.copy()
    shifted[:2, 2] -= 0.5
    return shifted


def undistort_points(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of the recorded image to (N, 2) pixels of the undistorted one."""
    K = opencv_intrinsics(camera.K)
    return cv2.undistortPoints(points.reshape(-1, 1, 2) - 0.5, K, camera.distortion, P=K).reshape(-1, 2) + 0.5


def resample(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Area-average an image, (H, W) or (H, W, 3), down to ``width`` x ``height``; the same array when sizes agree."""
    if image.shape[:2] == (height, width):
        return image
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def limited(camera: Camera, long_side: int | None) -> Camera:
    """The camera of the image resampled so that its longer side is at most ``long_side`` pixels."""
    longest = max(camera.width, camera.height)
    if long_side is None or longest <= long_side:
        return camera
    return camera.resized(round(camera.width * long_side / longest), round(camera.height * long_side / longest))


def describe(capture: Capture) -> Sequence:
    """Check a capture and choose its frames; each recording is decoded once to count what it really holds.

    Raises:
        ConfigError: frame or subject settings out of range, or no frame rate known.
        InputError: recordings that are truncated, out of step, of different rates, or too short.
        SubjectError: a subject outside the picture or the chosen frames.
    """
    settings = capture.frames
    _check_settings(settings)
    count, remarks = _common_count(capture)
    ids = choose_frames(count, settings)
    cameras = tuple(
        dataclasses.replace(limited(camera, settings.long_side), distortion=np.zeros(5)) for camera in capture.cameras
    )
    return Sequence(
        name=capture.name,
        fps=_rate(capture) / settings.stride,
        frame_ids=tuple(ids),
        up=capture.up,
        train=capture.train,
        eval=capture.eval,
        cameras=cameras,
        sources=tuple(Source(name, str(entry.path), entry.digest()) for name, entry in capture.recordings.items()),
        subject=_subject(capture, cameras[0], ids),
        remarks=(*capture.remarks, *remarks),
    )


def stored_frames(capture: Capture, sequence: Sequence, camera: str) -> Iterator[np.ndarray]:
    """(H, W, 3) RGB uint8 undistorted frames of one camera, in order; one is in memory at a time.

    Args:
        capture: where the frames come from.
        sequence: what :func:`describe` made of it: which frames, and at which size.
        camera: name of the camera.

    Raises:
        InputError: a frame that is missing, cannot be decoded, or has another size than the first.
    """
    target = sequence.camera(camera)
    recorded = next(entry for entry in capture.cameras if entry.name == camera)
    undistort = Undistortion(recorded)
    for image in capture.recordings[camera].frames(sequence.frame_ids):
        yield resample(undistort(image), target.width, target.height)


def choose_frames(count: int, settings: FrameSettings) -> range:
    """The frames kept of a recording of ``count`` frames.

    Raises:
        InputError: the range is empty or holds fewer than ``min_frames``.
    """
    ids = range(settings.start, min(count, count if settings.stop is None else settings.stop), settings.stride)
    ids = ids if settings.max_frames is None else ids[: settings.max_frames]
    if len(ids) < max(1, settings.min_frames):
        raise InputError(
            f"the chosen frames are too few: {len(ids)}",
            expected=f"at least {settings.min_frames} (dataset.frames.min_frames)",
            got=f"{count} frames recorded, start {settings.start}, stop {settings.stop}, stride {settings.stride}",
            cure="use a longer clip, or change dataset.frames.start, stop or stride",
        )
    return ids


def _check_settings(settings: FrameSettings) -> None:
    limits = {
        "start": 0,
        "stop": 1,
        "stride": 1,
        "max_frames": 1,
        "min_frames": 1,
        "long_side": 16,
        "count_tolerance": 0,
    }
    for name, least in limits.items():
        if (value := getattr(settings, name)) is not None and value < least:
            raise ConfigError(f"dataset.frames.{name}", expected=f"{least} or more", got=str(value))
    if not 1 <= settings.jpeg_quality <= 100:
        raise ConfigError("dataset.frames.jpeg_quality", expected="1 to 100", got=str(settings.jpeg_quality))
    if settings.fps is not None and settings.fps <= 0:
        raise ConfigError("dataset.frames.fps", expected="a positive rate", got=str(settings.fps))


def _common_count(capture: Capture) -> tuple[int, list[str]]:
    """Frames all recordings hold, and remarks about those that hold less than they promise or than the others."""
    settings, remarks, counts = capture.frames, [], {}
    for name, entry in capture.recordings.items():
        promised = entry.probe.promised or entry.count
        wanted = promised if settings.stop is None else settings.stop
        if (missing := min(promised, wanted) - entry.count) > 0:
            text = f"Camera {name}: {entry.count} of {promised} promised frames can be decoded."
            if missing > settings.count_tolerance:
                raise InputError(
                    text.rstrip("."),
                    expected=f"at most {settings.count_tolerance} missing (dataset.frames.count_tolerance)",
                    cure=f"copy the file again, it is truncated or damaged; or set dataset.frames.stop={entry.count}",
                )
            remarks.append(text)
        counts[name] = min(entry.count, wanted)
    least, most = min(counts.values()), max(counts.values())
    if most - least > settings.count_tolerance:
        raise InputError(
            "the cameras hold different numbers of frames",
            expected=f"equal within {settings.count_tolerance} (dataset.frames.count_tolerance)",
            got=", ".join(f"{name} {count}" for name, count in counts.items()),
            cure="cut the recordings to the same instants; cameras must be synchronous",
        )
    if most > least:
        remarks.append(f"The cameras hold {least} to {most} frames; the first {least} are used.")
    _check_numbers(capture, least)
    return least, remarks


def _check_numbers(capture: Capture, count: int) -> None:
    """Simultaneous images must carry the same number, or one missing file would shift a camera in time."""
    named = {name: entry.probe.numbers for name, entry in capture.recordings.items()}
    numbered = [(name, numbers[:count]) for name, numbers in named.items() if numbers is not None]
    for name, numbers in numbered[1:]:
        first, expected = numbered[0]
        if different := [(a, b) for a, b in zip(expected, numbers, strict=True) if a != b]:
            raise InputError(
                f"the images of cameras {first} and {name} are numbered differently",
                got=f"{different[0][0]} in {first} beside {different[0][1]} in {name}",
                cure="give simultaneous images the same number, and remove those that not every camera has",
            )


def _rate(capture: Capture) -> float:
    """Frames per second: configured, else calibrated, else the recordings' own."""
    if known := capture.frames.fps or capture.fps:
        return known
    rates = {name: rate for name, entry in capture.recordings.items() if (rate := entry.probe.fps) is not None}
    if not rates:
        raise ConfigError(
            "the frame rate is unknown", expected="dataset.frames.fps", cure="set it, in frames per second"
        )
    if max(rates.values()) > 1.01 * min(rates.values()):
        raise InputError(
            "the cameras run at different rates",
            got=", ".join(f"{name} {rate:g}" for name, rate in rates.items()),
            cure="resample the recordings to one rate, or set dataset.frames.fps if only the labels differ",
        )
    return next(iter(rates.values()))


def _subject(capture: Capture, stored: Camera, ids: range) -> Subject:
    """Carry the chosen subject from the recorded to the stored frames of the first training camera."""
    settings, camera = capture.subject, capture.cameras[0]
    size, scale = (camera.width, camera.height), np.array([stored.width / camera.width, stored.height / camera.height])
    point = box = None
    if settings.point is not None:
        point = undistort_points(camera, _inside("point", settings.point, size)) * scale
    if settings.box is not None:
        x0, y0, x1, y1 = settings.box
        if x0 >= x1 or y0 >= y1:
            raise SubjectError(
                "dataset.subject.box", expected="x0 < x1 and y0 < y1", got=str(settings.box), cure="correct the box"
            )
        corners = undistort_points(camera, _inside("box", (x0, y0, x1, y1, x0, y1, x1, y0), size)) * scale
        box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    frame = ids[0] if settings.frame is None else settings.frame
    if not ids[0] <= frame <= ids[-1]:
        raise SubjectError(
            "dataset.subject.frame is not among the chosen frames",
            expected=f"{ids[0]} to {ids[-1]}",
            got=str(frame),
            cure="name a frame of the recording in that range",
        )
    if settings.stature_m is not None and not 0.4 < settings.stature_m < 2.8:
        raise ConfigError("dataset.subject.stature_m", expected="metres, such as 1.75", got=str(settings.stature_m))
    return Subject(
        point=None if point is None else tuple(point[0].tolist()),
        box=None if box is None else tuple(box.tolist()),
        frame=round((frame - ids[0]) / ids.step),
        stature_m=settings.stature_m,
        camera=camera.name,
    )


def _inside(field: str, values: tuple[float, ...], size: tuple[int, int]) -> np.ndarray:
    points = np.array(values, np.float64).reshape(-1, 2)
    if not ((points >= 0) & (points <= size)).all():
        raise SubjectError(
            f"dataset.subject.{field} is outside the picture",
            expected=f"within {size[0]}x{size[1]}",
            got=str(values),
            cure="give pixels of the recording as a player shows it",
        )
    return points
