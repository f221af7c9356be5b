"""From recordings to the sequence record and stored frames: choice, size, distortion, subject, and bad input."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from soar.config import settings
from soar.datasets.ingest import Undistortion, choose_frames, describe, limited, stored_frames, undistort_points
from soar.datasets.recordings import VideoFile
from soar.datasets.selection import FrameSettings
from soar.errors import ConfigError, InputError, SubjectError
from soar.geometry.cameras import Camera
from tests.conftest import ROOT, conf
from tests.datasets.footage import (
    WIDTH,
    camera_entry,
    frame_number,
    node,
    open_adapter,
    write_capture,
    write_images,
    write_video,
)

FRAMES = settings(FrameSettings, conf("dataset", "video")["frames"])
LENS = (-0.3, 0.12, 0.004, -0.003, 0.02)


def capture_of(path: Path, **changes):
    return open_adapter("video", path=str(path), **changes).capture(path.stem)


def lens_camera(width: int = 160, height: int = 120) -> Camera:
    K = np.array([[140.0, 0, 77.3], [0, 143.0, 62.8], [0, 0, 1]])
    return Camera("lens", width, height, K, np.eye(4), np.array(LENS), "test")


def distort(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """The distortion model written out: undistorted pixels (N, 2) to recorded pixels (N, 2)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = ((pixels - camera.K[:2, 2]) / camera.K.diagonal()[:2]).T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([xd, yd], 1) * camera.K.diagonal()[:2] + camera.K[:2, 2]


def test_choose_frames():
    def chosen(count, **changes):
        return list(choose_frames(count, dataclasses.replace(FRAMES, min_frames=1, **changes)))

    assert chosen(5) == [0, 1, 2, 3, 4]
    assert chosen(10, start=2, stop=9, stride=3) == [2, 5, 8]
    assert chosen(10, stop=99, stride=4) == [0, 4, 8]
    assert chosen(10, start=1, max_frames=2) == [1, 2]
    for changes in ({"start": 10}, {"start": 4, "stop": 4}):
        with pytest.raises(InputError, match="too few: 0"):
            chosen(10, **changes)
    with pytest.raises(InputError, match="too few: 7"):
        choose_frames(7, dataclasses.replace(FRAMES, min_frames=8))


def test_undistorted_points_are_the_inverse_of_the_model():
    camera = lens_camera()
    points = np.array([[20.5, 30.5], [80.0, 60.0], [140.25, 100.75]])
    np.testing.assert_allclose(undistort_points(camera, distort(camera, points)), points, atol=1e-3)


def test_undistortion_shows_the_scene_a_pinhole_would_see():
    camera = lens_camera()

    def scene(pixels):
        u, v = pixels.T
        return 120 + 60 * np.sin(u / 9.0) * np.cos(v / 7.0)

    grid = np.stack(np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5), -1).reshape(-1, 2)
    recorded = scene(undistort_points(camera, grid)).reshape(120, 160)
    image = np.repeat(np.round(recorded)[..., None], 3, 2).astype(np.uint8)
    result = Undistortion(camera)(image)[..., 0].astype(float)
    expected = scene(grid).reshape(120, 160)
    inner = (slice(15, -15), slice(20, -20))
    assert np.abs(image[..., 0][inner] - expected[inner]).max() > 20, "the lens must matter for this test"
    # 8-bit rounding twice, and interpolation on 1/32 pixel steps at a slope of up to 9 levels a pixel.
    assert np.abs(result[inner] - expected[inner]).max() < 2.5
    assert np.abs(result[inner] - expected[inner]).mean() < 0.5


def test_no_distortion_keeps_pixels():
    camera = dataclasses.replace(lens_camera(), distortion=np.zeros(5))
    image = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
    assert Undistortion(camera)(image) is image


def test_limited():
    camera = lens_camera()
    assert limited(camera, None) is camera
    assert limited(camera, 160) is camera
    half = limited(camera, 80)
    assert (half.width, half.height) == (80, 60)
    np.testing.assert_allclose(half.K[:2], camera.K[:2] / 2)


def test_single_clip(tmp_path):
    path = write_video(tmp_path / "my clip (1).avi", 10)
    adapter = open_adapter("video", path=str(path), frames__start=1, frames__stride=2, subject__stature_m=1.8)
    assert adapter.sequences() == ["my_clip_1"]
    assert (adapter.cameras("my_clip_1"), adapter.cameras("my_clip_1", "eval")) == (["camera"], [])
    assert adapter.sources("my_clip_1") == [path]
    assert adapter.downloads() == []
    capture = adapter.capture("my_clip_1")
    sequence = describe(capture)
    assert sequence.frame_ids == (1, 3, 5, 7, 9)
    assert sequence.fps == pytest.approx(15)
    np.testing.assert_array_equal(sequence.up, (0, -1, 0))
    camera = sequence.camera("camera")
    np.testing.assert_allclose(camera.K[0, 0], WIDTH / 2 / np.tan(np.radians(30)))
    assert "assumed field of view of 60 degrees" in camera.K_source
    assert "assumed field of view" in sequence.remarks[0]
    assert sequence.subject.stature_m == 1.8
    assert sequence.sources[0].sha256 == VideoFile(path).digest()
    assert [frame_number(image) for image in stored_frames(capture, sequence, "camera")] == [1, 3, 5, 7, 9]


def test_given_intrinsics_and_size(tmp_path):
    path = write_video(tmp_path / "a.avi", 3)
    capture = capture_of(path, intrinsics__K=[90, 91, 47, 33], frames__long_side=48, intrinsics__distortion=LENS[:4])
    sequence = describe(capture)
    camera = sequence.camera("camera")
    np.testing.assert_allclose(camera.K, [[45, 0, 23.5], [0, 45.5, 16.5], [0, 0, 1]])
    assert not camera.distortion.any()
    assert sequence.remarks == ()
    assert next(stored_frames(capture, sequence, "camera")).shape == (32, 48, 3)


def test_subject_is_carried_to_the_stored_frames(tmp_path):
    path = write_video(tmp_path / "a.avi", 9)
    changes = {"frames__long_side": 48, "frames__stride": 2, "frames__start": 2}
    sequence = describe(
        capture_of(path, subject__point=[40, 20], subject__box=[10, 8, 50, 60], subject__frame=6, **changes)
    )
    assert sequence.subject.point == pytest.approx((20, 10))
    assert sequence.subject.box == pytest.approx((5, 4, 25, 30))
    assert (sequence.subject.frame, sequence.subject.camera) == (2, "camera")
    for bad in (
        {"subject__point": [400, 20]},
        {"subject__box": [10, 8, 10, 60]},
        {"subject__frame": 1},
    ):
        with pytest.raises(SubjectError, match=r"dataset\.subject"):
            describe(capture_of(path, **changes, **bad))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"frames__stride": 0}, ConfigError, "stride"),
        ({"frames__start": -1}, ConfigError, "start"),
        ({"frames__jpeg_quality": 0}, ConfigError, "jpeg_quality"),
        ({"frames__fps": -5.0}, ConfigError, "fps"),
        ({"subject__stature_m": 180.0}, ConfigError, "stature_m"),
        ({"intrinsics__assumed_fov_deg": 180}, ConfigError, "assumed_fov_deg"),
        ({"frames__min_frames": 8}, InputError, "too few: 6"),
        ({"frames__start": 6}, InputError, "too few: 0"),
    ],
)
def test_bad_settings(tmp_path, change, error, message):
    path = write_video(tmp_path / "a.avi", 6)
    with pytest.raises(error, match=message):
        describe(capture_of(path, **change))


def test_bad_paths(tmp_path):
    with pytest.raises(ConfigError, match=r"dataset\.path"):
        open_adapter("video")
    with pytest.raises(InputError, match="does not exist"):
        open_adapter("video", path=str(tmp_path / "a.avi"))
    other = tmp_path / "other"
    other.mkdir()
    same = [str(write_video(folder / "a.avi", 2)) for folder in (tmp_path, other)]
    with pytest.raises(InputError, match="both make the sequence 'a'"):
        open_adapter("video", path=same)


def test_unknown_keys_and_adapters():
    from soar.datasets import adapter

    with pytest.raises(ConfigError, match="dataset does not fit"):
        adapter(node("video") | {"pth": "x"})
    with pytest.raises(ConfigError, match="unknown dataset adapter"):
        adapter({"adapter": "vidio"})


def test_truncated_video(tmp_path):
    # In an AVI whose header promises more frames than the file holds, decoding ends early.
    path = write_video(tmp_path / "a.avi", 30)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="of 30 promised frames") as caught:
        describe(capture_of(path))
    kept = VideoFile(path).count
    assert f"dataset.frames.stop={kept}" in str(caught.value)
    assert len(describe(capture_of(path, frames__stop=kept))) == kept
    assert "promised" in describe(capture_of(path, frames__count_tolerance=30)).remarks[-1]


def test_image_folder_needs_a_rate(tmp_path):
    path = write_images(tmp_path / "take", [3, 4, 5])
    with pytest.raises(ConfigError, match="frame rate"):
        describe(capture_of(path))
    assert describe(capture_of(path, frames__fps=25.0)).fps == 25


def test_capture_of_several_cameras(tmp_path):
    entries = {"a": camera_entry(), "b": camera_entry(3.0, (64, 96), distortion=[-0.2, 0.1, 0, 0])}
    folder = write_capture(tmp_path / "lab-3", entries)
    write_images(folder / "c", [10, 11, 12, 13, 14, 15])
    entries["c"] = camera_entry(5.0)
    write_capture(folder, {})
    (folder / "calibration.json").write_text(json.dumps({"cameras": entries, "fps": 30}))
    adapter = open_adapter("cameras", path=str(folder), train=["b"])
    assert adapter.sequences() == ["lab-3"]
    assert adapter.cameras("lab-3") == ["b", "a", "c"]
    assert adapter.cameras("lab-3", "eval") == ["a", "c"]
    assert adapter.sources("lab-3")[:3] == [folder / "calibration.json", folder / "b.avi", folder / "a.avi"]
    assert len(adapter.sources("lab-3")) == 9
    capture = adapter.capture("lab-3")
    sequence = describe(capture)
    assert (sequence.names, sequence.train, sequence.eval) == (("b", "a", "c"), ("b",), ("a", "c"))
    assert not sequence.camera("b").distortion.any()
    np.testing.assert_allclose(sequence.camera("b").centre, (0, -3, 0))
    for name in sequence.names:
        assert [frame_number(image) for image in stored_frames(capture, sequence, name)] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"train": []}, "at least one training camera"),
        ({"train": ["z"]}, "split"),
        ({"train": ["a"], "eval": ["a"]}, "none twice"),
    ],
)
def test_bad_splits(tmp_path, change, message):
    write_capture(tmp_path / "lab", {"a": camera_entry(), "b": camera_entry()})
    with pytest.raises(ConfigError, match="split") as caught:
        open_adapter("cameras", path=str(tmp_path / "lab"), **change).cameras("lab")
    assert message in str(caught.value)


def test_cameras_out_of_step(tmp_path):
    folder = write_capture(tmp_path / "lab", {"a": camera_entry(), "b": camera_entry()})
    write_video(folder / "b.avi", 8)
    adapter = open_adapter("cameras", path=str(folder), train=["a"])
    with pytest.raises(InputError, match="different numbers of frames") as caught:
        describe(adapter.capture("lab"))
    assert "a 6, b 8" in str(caught.value)
    tolerant = open_adapter("cameras", path=str(folder), train=["a"], frames__count_tolerance=2)
    sequence = describe(tolerant.capture("lab"))
    assert len(sequence) == 6
    assert "6 to 8" in sequence.remarks[-1]
    assert len(describe(open_adapter("cameras", path=str(folder), train=["a"], frames__stop=5).capture("lab"))) == 5
    write_video(folder / "b.avi", 6, fps=25)
    with pytest.raises(InputError, match="different rates"):
        describe(adapter.capture("lab"))


def test_images_with_a_gap_are_out_of_step(tmp_path):
    folder = write_capture(tmp_path / "lab", {}, fps=30)
    write_images(folder / "a", [1, 2, 3, 4])
    write_images(folder / "b", [1, 2, 4, 5])
    (folder / "calibration.json").write_text(
        json.dumps({"fps": 30, "cameras": {"a": camera_entry(), "b": camera_entry()}})
    )
    with pytest.raises(InputError, match="a and b are numbered differently") as caught:
        describe(open_adapter("cameras", path=str(folder), train=["a"]).capture("lab"))
    assert "3 in a beside 4 in b" in str(caught.value)


def test_missing_and_ambiguous_recordings(tmp_path):
    folder = write_capture(tmp_path / "lab", {"a": camera_entry()})
    adapter = open_adapter("cameras", path=str(folder), train=["a"])
    write_video(folder / "a.mp4", 3, code="mp4v")
    with pytest.raises(InputError, match="camera a: several recordings"):
        adapter.sources("lab")
    (folder / "a.mp4").unlink()
    (folder / "a.avi").rename(folder / "film.avi")
    with pytest.raises(InputError, match="camera a: no recording"):
        adapter.sources("lab")
    entry = {"cameras": {"a": camera_entry(source="film.avi")}}
    (folder / "calibration.json").write_text(json.dumps(entry))
    assert adapter.sources("lab")[1] == folder / "film.avi"


def test_naming_sequences_cameras_and_sources_loads_no_numerical_library(tmp_path):
    folder = write_capture(tmp_path / "lab", {"a": camera_entry()})
    nodes = [node("demo"), node("video", path=str(folder / "a.avi")), node("cameras", path=str(folder), train=["a"])]
    script = (
        "import json, sys; from soar.datasets import adapter\n"
        "for node in json.loads(sys.argv[1]):\n"
        "    dataset = adapter(node)\n"
        "    for name in dataset.sequences(): dataset.cameras(name), dataset.sources(name), dataset.downloads()\n"
        "print(sorted({'numpy', 'cv2', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script, json.dumps(nodes)], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr
