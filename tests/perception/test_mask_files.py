"""Masks made elsewhere: which belongs to which frame, what a picture says, where it lies on the stored frame."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from soar.config import settings
from soar.datasets import adapter
from soar.datasets.ingest import describe, stored_frames
from soar.errors import ConfigError, InputError
from soar.perception.mask_files import MaskFiles, MaskFileSettings
from tests.datasets.footage import node
from tests.perception.exports import masks_node

WIDTH, HEIGHT, COUNT = 120, 80, 8


def truth(t: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(H, W) uint8 mask of frame t: a block near a corner, where a lens bends, that moves with time."""
    mask = np.zeros((height, width), np.uint8)
    mask[height // 8 : height * 3 // 4, (4 + 5 * t) * width // 120 : (34 + 5 * t) * width // 120] = 255
    return mask


def footage(folder: Path, numbers: list[int], **changes: Any) -> dict[str, Any]:
    """A folder of numbered images in which the person is white, and its node ``dataset``."""
    folder.mkdir()
    for t, number in enumerate(numbers):
        cv2.imwrite(str(folder / f"f{number}.png"), np.repeat(truth(t)[..., None], 3, 2))
    return node("video", path=str(folder), **({"frames__min_frames": 2, "frames__fps": 30.0} | changes))


def video(path: Path, frames: list[np.ndarray]) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, frames[0].shape[::-1])
    for frame in frames:
        writer.write(np.repeat(frame[..., None], 3, 2))
    writer.release()
    return path


def write(folder: Path, pictures: dict[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, picture in pictures.items():
        assert cv2.imwrite(str(folder / name), picture)
    return folder


def opened(dataset: dict[str, Any], source: Path, **changes: Any) -> MaskFiles:
    options = masks_node("files", dataset=dataset, **changes)
    del options["device"]
    sequence = describe(adapter(dataset).capture("footage"))
    return MaskFiles(settings(MaskFileSettings, options, "masks"), source, sequence, "camera")


def read(dataset: dict[str, Any], source: Path, **changes: Any) -> list[np.ndarray]:
    """All masks; keypoints are unknown."""
    files = opened(dataset, source, **changes)
    return list(files.masks(np.zeros((len(files._positions), 25, 3))))


def stored(dataset: dict[str, Any]) -> list[np.ndarray]:
    """(H, W) in [0, 1]: the person in the stored frames, where they are white."""
    capture = adapter(dataset).capture("footage")
    return [frame[..., 0] / 255 for frame in stored_frames(capture, describe(capture), "camera")]


@pytest.fixture
def clip(tmp_path: Path) -> dict[str, Any]:
    return footage(tmp_path / "footage", list(range(COUNT)))


@pytest.mark.parametrize("scale", [1, 2, 0.5])
def test_masks_of_the_recording_follow_its_lens_and_size(tmp_path, scale):
    lens = {"intrinsics__K": [100, 100, 60, 40], "intrinsics__distortion": [-0.4, 0.1, 0, 0]}
    dataset = footage(tmp_path / "footage", list(range(COUNT)), frames__stride=3, frames__long_side=90, **lens)
    sizes = round(scale * WIDTH), round(scale * HEIGHT)
    masks = {f"{t}.png": cv2.resize(truth(t), sizes, interpolation=cv2.INTER_AREA) for t in range(COUNT)}
    found, frames = read(dataset, write(tmp_path / "masks", masks)), stored(dataset)
    assert len(found) == len(frames) == 3
    for mask, frame in zip(found, frames, strict=True):
        assert mask.shape == frame.shape == (60, 90)
        assert mask.dtype == np.float32
        assert np.abs(mask - frame).mean() < 0.015
    plain = cv2.resize(truth(0), (90, 60), interpolation=cv2.INTER_AREA) / 255
    assert np.abs(found[0] - plain).mean() > 0.03  # the lens does bend this much


def test_masks_of_stored_frames_are_not_undistorted_again(tmp_path):
    lens = {"intrinsics__K": [100, 100, 60, 40], "intrinsics__distortion": [-0.4, 0.1, 0, 0]}
    dataset = footage(tmp_path / "footage", list(range(COUNT)), frames__stride=2, **lens)
    frames = stored(dataset)
    masks = {f"{t + 1:06d}.png": np.round(frame * 255).astype(np.uint8) for t, frame in enumerate(frames)}
    source = write(tmp_path / "masks", masks)
    for found in (
        read(dataset, source, made_of="frames", first_number=1),
        read(dataset, source, made_of="frames", match="order"),
    ):
        np.testing.assert_allclose(found, frames, atol=1e-6)
    with pytest.raises(InputError, match="lacks masks of 1 of 4"):
        read(dataset, source, made_of="frames")


def test_numbers_are_those_of_recorded_images(tmp_path):
    numbers = [3, 4, 7, 20, 21, 22, 30, 31]
    dataset = footage(tmp_path / "footage", numbers, frames__start=2, frames__stop=5)
    masks = {f"mask_{number:05d}.png": truth(t) for t, number in enumerate(numbers)}
    found = read(dataset, write(tmp_path / "masks", masks))
    np.testing.assert_array_equal(found, np.stack([truth(t) for t in (2, 3, 4)]) / 255)


def test_numbers_of_a_video_count_from_where_the_user_says(tmp_path):
    dataset = node("video", path=str(video(tmp_path / "footage.avi", [truth(t) for t in range(COUNT)])))
    dataset["frames"] |= {"min_frames": 2, "start": 2, "stride": 2}
    source = write(tmp_path / "masks", {f"{t + 1:04d}.png": truth(t) for t in range(COUNT)})
    found = read(dataset, source, first_number=1)
    np.testing.assert_array_equal(found, np.stack([truth(t) for t in (2, 4, 6)]) / 255)


def test_order_is_settled_by_the_count(tmp_path):
    dataset = footage(tmp_path / "footage", list(range(COUNT)), frames__start=1, frames__stride=3)
    kept = [1, 4, 7]
    sources = {
        "recorded": video(tmp_path / "recorded.avi", [truth(t) for t in range(COUNT)]),
        "kept": video(tmp_path / "kept.avi", [truth(t) for t in kept]),
        "images": write(tmp_path / "images", {f"{9 + i}.png": truth(t) for i, t in enumerate(kept)}),
    }
    for source in sources.values():
        found = read(dataset, source, match="order")
        assert len(found) == len(kept)
        for mask, t in zip(found, kept, strict=True):
            assert np.abs(mask - truth(t) / 255).mean() < 0.015
    with pytest.raises(InputError, match="holds 4 masks") as error:
        read(dataset, video(tmp_path / "four.avi", [truth(0)] * 4), match="order")
    assert error.value.expected == "3, one for every frame kept, or 8, one for every frame recorded"
    with pytest.raises(ConfigError, match="have no numbers"):
        read(dataset, sources["recorded"])


def pictures(kind: str) -> list[np.ndarray]:
    masks = [truth(t) for t in range(COUNT)]
    return {
        "grey": masks,
        "colour": [np.repeat(mask[..., None], 3, 2) for mask in masks],
        "16 bit": [mask.astype(np.uint16) * 257 for mask in masks],
        "cut-out": [np.dstack([np.full((HEIGHT, WIDTH, 3), (40, 90, 200), np.uint8), mask]) for mask in masks],
        "labels": [mask // 255 for mask in masks],
        "half": [mask // 255 * 128 for mask in masks],
        "opaque": [np.dstack([mask] * 3 + [np.full_like(mask, 255)]) for mask in masks],
    }[kind]


@pytest.mark.parametrize(
    ("kind", "suffix", "changes", "level"),
    [
        ("grey", "png", {}, 1),
        ("grey", "jpg", {}, 1),
        ("grey", "tif", {}, 1),
        ("colour", "png", {}, 1),
        ("colour", "webp", {}, 1),
        ("16 bit", "png", {}, 1),
        ("cut-out", "png", {"plane": "alpha"}, 1),
        ("cut-out", "webp", {"plane": "alpha"}, 1),
        ("opaque", "png", {}, 1),
        ("labels", "png", {"white": 1}, 1),
        ("half", "png", {"white": 128}, 1),
        ("16 bit", "png", {"white": 65535}, 1),
    ],
)
def test_what_a_picture_may_be(clip, tmp_path, kind, suffix, changes, level):
    source = write(tmp_path / "masks", {f"{t}.{suffix}": picture for t, picture in enumerate(pictures(kind))})
    for t, mask in enumerate(read(clip, source, **changes)):
        assert mask.max() == pytest.approx(level, abs=0.02)
        assert np.abs(mask - truth(t) / 255).mean() < 0.015


@pytest.mark.parametrize(
    ("kind", "changes", "says"),
    [
        ("cut-out", {}, "0.png is coloured"),
        ("grey", {"plane": "alpha"}, "0.png has no alpha channel"),
        ("opaque", {"plane": "alpha"}, "0.png is white all over"),
        ("labels", {}, "empty masks only"),
        ("grey", {"white": 1}, "0.png is brighter than white"),
    ],
)
def test_what_a_picture_may_not_be(clip, tmp_path, kind, changes, says):
    source = write(tmp_path / "masks", {f"{t}.png": picture for t, picture in enumerate(pictures(kind))})
    with pytest.raises(InputError, match=says):
        read(clip, source, **changes)


def test_soft_edges_stay_soft(clip, tmp_path):
    soft = cv2.GaussianBlur(truth(0), (0, 0), 3)
    found = read(clip, write(tmp_path / "masks", {f"{t}.png": soft for t in range(COUNT)}))
    np.testing.assert_array_equal(found[0], soft / np.float32(255))


def test_damaged_missing_and_misshapen_masks(clip, tmp_path):
    masks = {f"{t}.png": truth(t) for t in range(COUNT)}
    source = write(tmp_path / "masks", masks)
    (source / "3.png").write_bytes((source / "3.png").read_bytes()[:40])
    with pytest.raises(InputError, match=r"3\.png cannot be decoded"):
        read(clip, source)
    (source / "3.png").unlink()
    with pytest.raises(InputError, match="lacks masks of 1 of 8") as error:
        read(clip, source)
    assert "without 3" in error.value.got
    turned = write(tmp_path / "turned", {name: mask.T for name, mask in masks.items()})
    with pytest.raises(InputError, match="another shape") as error:
        read(clip, turned)
    assert error.value.expected.startswith("120x80")
    assert error.value.got == "80x120"
    with pytest.raises(InputError, match="another shape"):
        read(clip, write(tmp_path / "padded", {name: np.pad(mask, ((0, 8), (0, 0))) for name, mask in masks.items()}))
    with pytest.raises(InputError, match="does not exist"):
        read(clip, tmp_path / "none")
    with pytest.raises(InputError, match="holds no images"):
        read(clip, write(tmp_path / "empty", {}))
    white = write(tmp_path / "white", masks | {"5.png": np.full((HEIGHT, WIDTH), 255, np.uint8)})
    with pytest.raises(InputError, match=r"5\.png is white all over"):
        read(clip, white)


@pytest.mark.parametrize("changes", [{}, {"match": "order"}])
def test_an_image_that_claims_an_absurd_size(clip, tmp_path, changes):
    source = write(tmp_path / "masks", {f"{t}.png": truth(t) for t in range(COUNT)})
    data = bytearray((source / "0.png").read_bytes())
    data[16:24] = struct.pack(">II", 200_000, 200_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    (source / "0.png").write_bytes(data)
    with pytest.raises(InputError, match="cannot be decoded"):
        read(clip, source, **changes)


def test_empty_masks_among_others_are_left(clip, tmp_path):
    masks = {f"{t}.png": truth(t) * (t != 2) for t in range(COUNT)}
    found = read(clip, write(tmp_path / "masks", masks))
    assert [bool(mask.any()) for mask in found] == [t != 2 for t in range(COUNT)]


def test_masks_must_lie_on_the_keypoints(clip, tmp_path):
    body = np.zeros((COUNT, 25, 3))
    for t in range(COUNT):
        body[t, :, :2] = [15 + 5 * t, 40]
    body[:, :20, 2] = 0.9
    body[:, 15:20, :2] = (115, 75)  # a quarter is elsewhere, which is no reason
    body[0, :, :2] = (-5, 300)  # and a frame has none within the picture
    right = write(tmp_path / "right", {f"{t}.png": truth(t) for t in range(COUNT)})
    assert len(list(opened(clip, right).masks(body))) == COUNT
    with pytest.raises(InputError, match="not on the person") as error:
        list(opened(clip, right, min_agreement=0.8).masks(body))
    assert error.value.got == "75% in the median frame"
    inverted = write(tmp_path / "inverted", {f"{t}.png": 255 - truth(t) for t in range(COUNT)})
    with pytest.raises(InputError, match="not on the person") as error:
        list(opened(clip, inverted).masks(body))
    assert error.value.got == "25% in the median frame"
