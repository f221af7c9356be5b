"""The normal networks of others: files of their layout with known answers, what they are shown, what comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import helper

from soar.errors import ConfigError, ModelFileError
from soar.perception import sapiens
from soar.perception.normal_maps import sampled, seen_from
from soar.perception.normals import normal_provider, sign_test
from tests.conftest import conf
from tests.perception import normal_scenes as scenes


def provider(option: str, path: Path, crop: Any) -> Any:
    node = conf("normals", option) | {"device": "cpu"}
    return normal_provider(node, scenes.context([crop], {"network": path}))


def assert_truth(got: np.ndarray, side: str, tolerance: float) -> None:
    expected = scenes.truth(side)
    inner = np.abs(expected[..., 2]) > 0.3
    assert np.abs(got[inner] - expected[inner]).max() < tolerance
    assert np.abs((got[inner] - expected[inner]).mean(0)[:2]).max() < 0.004
    assert not got[np.abs(expected).max(-1) == 0].any()


def test_icon_networks_that_return_the_body_give_the_body(tmp_path: Path) -> None:
    crop = scenes.crop()
    found = provider("icon", scenes.returning_body(tmp_path), crop).maps(crop)
    assert sign_test(*found).passed
    for got, side in zip(found, ("front", "back"), strict=True):
        assert got.dtype == np.float32
        assert_truth(got, side, 0.03)
        # Up to the rim of the mask, but for pixels that only the true sphere reaches, not the mesh.
        assert (np.abs(np.linalg.norm(got[crop.alpha > 127], axis=-1) - 1) < 1e-5).mean() > 0.998


def test_what_icon_networks_are_shown(tmp_path: Path) -> None:
    rgb = np.zeros((80, 96, 3), np.uint8)
    rgb[..., 0], rgb[..., 1], rgb[..., 2] = 255, 51, np.arange(96)
    crop = scenes.crop(rgb=rgb)
    made = provider("icon", scenes.returning_body(tmp_path), crop)
    seen: list[dict[str, np.ndarray]] = []

    class Recorded:
        def __init__(self, network: Any) -> None:
            self.network = network

        def get_inputs(self) -> Any:
            return self.network.get_inputs()

        def run(self, names: Any, feed: dict[str, np.ndarray]) -> Any:
            seen.append({name: value[0] for name, value in feed.items()})
            return self.network.run(names, feed)

    made.sessions = [Recorded(network) for network in made.sessions]
    made.maps(crop)
    front, back = seen
    person = np.abs(front["image"]).max(0) > 0
    rows, columns = np.flatnonzero(person.any(1)), np.flatnonzero(person.any(0))
    sides = (rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1)
    assert max(sides) == pytest.approx(512 / 1.11, abs=8)  # a pixel of the crop is 8 of the square
    assert rows[0] + rows[-1] == pytest.approx(511, abs=9)
    assert columns[0] + columns[-1] == pytest.approx(511, abs=9)
    # Colours in [-1, 1] in the order red, green, blue, and exactly zero beyond the person.
    assert np.abs(front["image"][:2, person] - [[1.0], [-0.6]]).max() < 1e-5
    assert np.all(np.diff(front["image"][2, 256, columns[20] : columns[-20]]) >= 0)
    assert not front["image"][:, ~person].any()
    np.testing.assert_array_equal(front["image"], back["image"])
    # The body's normals in the front view's OpenGL-like axes, both of them, and nothing where the body is not.
    assert front["T_normal_F"].shape == (3, 512, 512)
    for normals, sign in ((front["T_normal_F"], 1), (back["T_normal_B"], -1)):
        surface = np.abs(normals).max(0) > 0
        assert sign * np.median(normals[2, surface]) > 0.5
        assert normals[1, rows[40], 256] > 0.5  # above, they point up
        assert normals[0, 256, columns[40]] < -0.5  # to the left, left
        assert not normals[:, 0, 0].any()


def test_icon_without_a_person_in_view(tmp_path: Path) -> None:
    crop = scenes.crop(alpha=np.zeros((80, 96), np.uint8))
    assert not any(side.any() for side in provider("icon", scenes.returning_body(tmp_path), crop).maps(crop))


def test_other_icon_folders_are_refused(tmp_path: Path) -> None:
    crop = scenes.crop()
    with pytest.raises(ModelFileError, match=r"netF\.onnx is missing"):
        provider("icon", tmp_path, crop)
    with pytest.raises(ModelFileError, match=r"other inputs(.*\n)*.*expected: image \(1, 3, 512, 512\)(.*\n)*.*256"):
        provider("icon", scenes.returning_body(tmp_path / "small", 256), crop)
    scenes.returning_body(tmp_path / "swapped")
    (tmp_path / "swapped" / "netB.onnx").replace(tmp_path / "swapped" / "netF.onnx")
    with pytest.raises(ModelFileError, match=r"expected: image.*T_normal_F(.*\n)*.*got: .*T_normal_B"):
        provider("icon", tmp_path / "swapped", crop)
    with pytest.raises(ConfigError, match=r"normals\.network is not set"):
        normal_provider(conf("normals", "icon"), scenes.context([crop]))


def sapiens_network(path: Path, size: tuple[int, int] = (1024, 768), length: float = 3.0) -> Path:
    """Takes colours for normals in ICON's axes, as if (n + 1) / 2 were painted; gives a quarter of the resolution."""
    height, width = size
    nodes = [
        scenes.constant("std", (np.array([58.5, 57.0, 57.5], np.float32) / 127.5)[None, :, None, None]),
        scenes.constant("mean", (np.array([123.5, 116.5, 103.5], np.float32) / 127.5 - 1)[None, :, None, None]),
        scenes.constant("length", np.float32(length)),
        helper.make_node("AveragePool", ["pixels"], ["small"], kernel_shape=[4, 4], strides=[4, 4]),
        helper.make_node("Mul", ["small", "std"], ["scaled"]),
        helper.make_node("Add", ["scaled", "mean"], ["shifted"]),
        helper.make_node("Mul", ["shifted", "length"], ["out"]),
    ]
    shape = (1, 3, height // 4, width // 4)
    return scenes.network(path, {"pixels": (1, 3, height, width)}, "out", nodes, shape)


@pytest.mark.parametrize("length", [1.0, 40.0])
def test_sapiens_gives_the_front_and_the_body_the_back(tmp_path: Path, length: float) -> None:
    painted = np.uint8(np.round((scenes.truth("front") * (1, -1, -1) + 1) * 127.5))
    crop = scenes.crop(rgb=painted)
    made = provider("sapiens", sapiens_network(tmp_path / "n.onnx", length=length), crop)
    front, back = made.maps(crop)
    assert sign_test(front, back).passed
    inner = np.abs(scenes.truth("front")[..., 2]) > 0.5
    assert np.abs(front[inner] - scenes.truth("front")[inner]).max() < 0.03
    assert np.abs((front[inner] - scenes.truth("front")[inner]).mean(0)[:2]).max() < 0.004
    assert_truth(back, "back", 0.02)
    assert "front only" in made.remarks[0]


def test_sapiens_keeps_the_aspect_of_people(tmp_path: Path) -> None:
    """A wide and a tall crop are shown at one scale across and down, with the mean colour around them."""
    for height, width in ((40, 120), (120, 40)):
        box = sapiens._filled_out(height, width)
        across, down = sapiens.WIDTH / (box[2] - box[0]), sapiens.HEIGHT / (box[3] - box[1])
        assert across == pytest.approx(down)
        assert box[0] <= 0 <= width <= box[2]
        assert box[1] <= 0 <= height <= box[3]
        assert (box[0] + box[2], box[1] + box[3]) == pytest.approx((width, height))


def test_other_sapiens_networks_are_refused(tmp_path: Path) -> None:
    crop = scenes.crop()
    with pytest.raises(ModelFileError, match=r"expected: \* \(any, 3, 1024, 768\) float32"):
        provider("sapiens", sapiens_network(tmp_path / "a.onnx", (512, 384)), crop)
    with pytest.raises(ModelFileError, match="is missing"):
        provider("sapiens", tmp_path / "b.onnx", crop)


def test_windows_are_resampled_where_they_are() -> None:
    rows, columns = np.mgrid[:40, :60] + 0.5
    plane = np.stack([columns, rows], -1).astype(np.float32)
    for box, size in (((10, 5, 34, 29), (24, 24)), ((10.5, 4.25, 34.5, 28.25), (48, 96)), ((8, 4, 48, 36), (10, 8))):
        x0, y0, x1, y1 = box
        got = sampled(plane, box, *size)
        x = x0 + (np.arange(size[0]) + 0.5) * (x1 - x0) / size[0]
        y = y0 + (np.arange(size[1]) + 0.5) * (y1 - y0) / size[1]
        np.testing.assert_allclose(got[size[1] // 2, 1:-1, 0], x[1:-1], atol=0.05)
        np.testing.assert_allclose(got[1:-1, size[0] // 2, 1], y[1:-1], atol=0.05)
    assert not sampled(plane, (-30, -30, -10, -10), 5, 5).any()
    assert not sampled(plane, (100, 0, 120, 10), 5, 5).any()
    np.testing.assert_array_equal(sampled(plane, (-2, -1, 60, 40), 62, 41)[1:, 2:], plane)


def test_a_box_as_another_shows_it() -> None:
    assert seen_from((10, 20, 30, 60), (10, 20, 20, 40), 100, 100) == (0, 0, 200, 200)
    assert seen_from((0, 0, 8, 8), (4, 2, 6, 6), 10, 10) == (-20, -5, 20, 15)
