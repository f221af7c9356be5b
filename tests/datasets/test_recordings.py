"""Videos and image folders: content, order, rotation, and what is wrong with them."""

from __future__ import annotations

import numpy as np
import pytest

from soar.datasets.recordings import ImageFolder, VideoFile, recording
from soar.errors import InputError
from tests.datasets.footage import HEIGHT, WIDTH, frame_number, turn, write_images, write_video


@pytest.mark.parametrize(("name", "code"), [("a.mp4", "mp4v"), ("a.avi", "MJPG"), ("a.webm", "VP80")])
def test_video_yields_the_chosen_frames(tmp_path, name, code):
    clip = recording(write_video(tmp_path / name, 9, code=code))
    assert (clip.probe.width, clip.probe.height, clip.count) == (WIDTH, HEIGHT, 9)
    assert clip.probe.fps == pytest.approx(30, rel=0.01)
    images = list(clip.frames([1, 4, 8]))
    assert [frame_number(image) for image in images] == [1, 4, 8]
    red, green, blue = images[0][4, 4].astype(int)
    assert red > 180
    assert max(green, blue) < 70


def test_rotation_metadata_is_honoured(tmp_path):
    clip = VideoFile(write_video(tmp_path / "phone.mp4", 4, code="mp4v"))
    turn(clip.path)
    assert (clip.probe.width, clip.probe.height) == (HEIGHT, WIDTH)
    image = next(clip.frames([2]))
    assert image.shape == (WIDTH, HEIGHT, 3)
    assert image[4, -4, 0] > 180, "the top-left square belongs at the top right after a clockwise turn"
    assert image[4, 4, 0] < 120


def test_reading_past_the_end_is_named(tmp_path):
    clip = VideoFile(write_video(tmp_path / "a.avi", 3))
    with pytest.raises(InputError, match="ends before frame 3"):
        list(clip.frames([0, 5]))


def test_a_file_that_is_no_video(tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"not a video" * 100)
    with pytest.raises(InputError, match="cannot be opened"):
        _ = VideoFile(path).probe


def test_nothing_there(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        recording(tmp_path / "missing.mp4")


def test_images_are_ordered_by_number(tmp_path):
    folder = recording(write_images(tmp_path / "take", [8, 9, 10, 11, 100]))
    assert isinstance(folder, ImageFolder)
    assert folder.probe.numbers == (8, 9, 10, 11, 100)
    assert folder.count == 5
    assert [frame_number(image) for image in folder.frames([0, 2, 4])] == [0, 2, 4]
    np.testing.assert_array_equal(next(folder.frames([0]))[0, 0], (230, 20, 20))


def test_mixed_image_sizes_name_the_file(tmp_path):
    folder = write_images(tmp_path / "take", [1, 2])
    write_images(folder, [3], (WIDTH, HEIGHT + 2))
    with pytest.raises(InputError, match="mixes image sizes") as caught:
        list(ImageFolder(folder).frames([0, 1, 2]))
    assert "take2_3.png" in str(caught.value)


def test_image_folder_errors(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="holds no images"):
        ImageFolder(empty).files()
    folder = write_images(tmp_path / "take", [1])
    (folder / "title.png").write_bytes((folder / "take2_1.png").read_bytes())
    with pytest.raises(InputError, match="no frame number"):
        ImageFolder(folder).files()
    (folder / "title.png").rename(folder / "copy_0001.png")
    with pytest.raises(InputError, match="same frame number 1"):
        ImageFolder(folder).files()
    (folder / "copy_0001.png").unlink()
    (folder / "take2_1.png").write_bytes(b"broken")
    with pytest.raises(InputError, match="cannot be decoded"):
        _ = ImageFolder(folder).probe


def test_digest_follows_content(tmp_path):
    folder = ImageFolder(write_images(tmp_path / "take", [1, 2]))
    before = folder.digest()
    write_images(folder.path, [2, 1])
    assert ImageFolder(folder.path).digest() != before
    clip = VideoFile(write_video(tmp_path / "a.avi", 2))
    assert len(clip.digest()) == 64
