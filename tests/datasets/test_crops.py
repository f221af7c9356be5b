"""Windows, their cameras, and the crops stage end to end."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from soar.artifacts import read_npz, write_images, write_json
from soar.config import settings
from soar.datasets.crops import CropSettings, border_share, cut, find_windows, person_rows_columns, place_windows
from soar.datasets.ingest import limited
from soar.datasets.sequence import Sequence, Subject
from soar.errors import ArtifactError, SubjectError
from soar.geometry.cameras import Camera
from soar.health import Health
from soar.stages import Job, crops
from tests.conftest import conf

SETTINGS = settings(CropSettings, conf("crops", "default"))
WIDTH, HEIGHT = 400, 300


def camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    angle = 0.3
    T = np.eye(4)
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    T[:3, 3] = (0.1, -0.2, 4.0)
    K = np.array([[350.0, 0, 196.5], [0, 352.0, 148.25], [0, 0, 1]])
    return Camera("cam", width, height, K, T, np.zeros(5), "test")


def mask(x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[max(y0, 0) : y1, max(x0, 0) : x1] = 255
    return image


def test_person_rows_columns():
    image = np.zeros((20, 30), np.uint8)
    image[5:15, 8:20] = 200
    image[0, 29] = 255  # a speck
    rows, columns = person_rows_columns(image, 0.5, 3)
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (5, 14, 8, 19)
    assert person_rows_columns(image, 0.9, 3)[0].size == 0


def test_windows_hold_every_box_with_its_margin():
    rng = np.random.default_rng(3)
    corner = rng.integers(-20, 200, (40, 2))
    boxes = np.concatenate([corner, corner + rng.integers(5, 180, (40, 2))], axis=1)
    rect = place_windows(boxes, 0.1, 16)
    assert (rect[:, 2:] == rect[0, 2:]).all()
    assert (rect[0, 2:] % 16 == 0).all()
    room = 0.1 * (boxes[:, 2:] - boxes[:, :2]).max(axis=1, keepdims=True)
    assert (boxes[:, :2] - rect[:, :2] >= room - 1).all(), "at most one pixel less than the margin by rounding"
    assert (rect[:, :2] + rect[:, 2:] - boxes[:, 2:] >= room - 1).all()
    needed = ((boxes[:, 2:] - boxes[:, :2]) + 2 * room).max(axis=0)
    assert (rect[0, 2:] < needed + 16).all(), "no larger than rounding up demands"


def test_cut_brute_force():
    image = np.random.default_rng(0).integers(1, 255, (7, 9, 3), np.uint8)
    for rect in ((2, 1, 4, 3), (-2, -3, 6, 5), (6, 4, 8, 8), (-3, -3, 16, 16), (20, 2, 4, 4), (-9, -9, 4, 4)):
        x0, y0, width, height = rect
        expected = np.zeros((height, width, 3), np.uint8)
        for y in range(height):
            for x in range(width):
                if 0 <= y + y0 < 7 and 0 <= x + x0 < 9:
                    expected[y, x] = image[y + y0, x + x0]
        np.testing.assert_array_equal(cut(image, np.array(rect)), expected)
        np.testing.assert_array_equal(cut(image[..., 0], np.array(rect)), expected[..., 0])


def test_border_share():
    alpha = np.zeros((2, 6, 6), np.uint8)
    assert border_share(alpha) == 0
    alpha[0, 0:4, 2] = 100
    assert border_share(alpha) == 0.25


def test_empty_frames_are_left_out_and_nobody_is_an_error():
    working = limited(camera(), 200)
    nobody = np.zeros((HEIGHT, WIDTH), np.uint8)
    windows = find_windows([nobody, mask(100, 50, 180, 250), nobody, mask(-9, 60, 80, 240)], working, SETTINGS)
    assert windows.frame_index.tolist() == [1, 3]
    assert (windows.frames, windows.cut_off) == (4, 1)
    with pytest.raises(SubjectError, match="cam: no frame shows a person"):
        find_windows([nobody, nobody], working, SETTINGS)


def disk(centre: np.ndarray, radius: float) -> np.ndarray:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    return np.clip(radius + 0.5 - np.hypot(x - centre[0], y - centre[1]), 0, 1)


@pytest.fixture
def recorded(tmp_path):
    """A ball of known world positions, seen as a disk; half of it leaves the image in the last frame."""
    cam = camera()
    points = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.4], [-0.5, 0.3, -0.3], [-0.55, -0.62, 0.1]])
    points[3] = np.linalg.inv(cam.R) @ (np.array([-2.2, -1.0, 4.0]) - cam.t)
    disks = [disk(pixel, 30.0) for pixel in cam.project(points)]
    subject = Subject(None, None, 0, None, "cam")
    up = np.array([0.0, -1, 0])
    record = Sequence("ball", 30.0, (0, 5, 10, 15), up, ("cam",), (), (cam,), (), subject, ())
    files = {name: tmp_path / name for name in ("sequence", "calibration", "frames", "masks")}
    record.write(files["sequence"])
    write_json(files["calibration"], {"cameras": [cam.to_json()]})
    colour = (np.stack([d, 1 - d, np.full_like(d, 0.5)], -1) for d in disks)
    write_images(files["frames"], ((255 * c).round().astype(np.uint8) for c in colour), ".png")
    write_images(files["masks"], ((255 * d).round().astype(np.uint8) for d in disks), ".png")
    return files, points, cam


def run(files, tmp_path, **changes):
    out = {"crops": tmp_path / "cam.npz", "health": tmp_path / "h.json", "evidence": tmp_path / "e.jpg"}
    node = {"crops": conf("crops", "default") | changes}
    crops.run(files, out, node, Job("ball", "cam", 0, 1, tmp_path / "scratch"))
    return out


def test_projection_through_the_crop_cameras(recorded, tmp_path):
    files, points, cam = recorded
    out = run(files, tmp_path, long_side=200)
    data = read_npz(out["crops"])
    assert data["rgb"].shape == (4, *data["alpha"].shape[1:], 3)
    assert (data["rgb"].dtype, data["alpha"].dtype) == (np.uint8, np.uint8)
    assert data["scale"] == 0.5
    np.testing.assert_array_equal(data["frame_index"], range(4))
    np.testing.assert_array_equal(data["T_cam_from_world"], cam.T_cam_from_world)
    height, width = data["alpha"].shape[1:]
    y, x = np.mgrid[0:height, 0:width] + 0.5
    for i in range(3):
        weight = data["alpha"][i].astype(float)
        seen = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        in_crop = dataclasses.replace(cam, width=width, height=height, K=data["K"][i]).project(points[i])
        np.testing.assert_allclose(seen, in_crop, atol=0.02)
        assert data["rgb"][i][int(seen[1]), int(seen[0])].tolist() == [255, 0, 128]
        np.testing.assert_array_equal(data["rect"][i, 2:], (width, height))
        np.testing.assert_allclose(cam.project(points[i]) / 2 - data["rect"][i, :2], in_crop)


def test_window_may_leave_the_image(recorded, tmp_path):
    files, _, _ = recorded
    data = read_npz(run(files, tmp_path, long_side=400)["crops"])
    x0 = data["rect"][3, 0]
    assert x0 < 0
    outside = (slice(None), slice(0, -x0))
    assert not data["alpha"][3][outside].any()
    assert not data["rgb"][3][outside].any()
    assert data["rgb"][3][:, -x0:].any()
    health = Health.read(tmp_path / "h.json")
    assert health.numbers["border_share"]["value"] == 0
    assert health.numbers["cut_off_frames"]["value"] == 0.25
    assert health.numbers["empty_frames"]["value"] == 0
    assert "1 of 4" in health.remarks[0]
    assert (tmp_path / "e.jpg").stat().st_size > 1000


def test_mask_archive_that_does_not_fit(recorded, tmp_path):
    files, _, _ = recorded
    write_images(files["masks"], [mask(10, 10, 50, 50)], ".png")
    with pytest.raises(ArtifactError, match="masks do not fit"):
        run(files, tmp_path)
    assert not (tmp_path / "cam.npz").exists()
