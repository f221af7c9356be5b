"""The normals stage with what users bring: files and networks that say what the body says must give the body's maps."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from soar.artifacts import read_json, read_npz
from soar.errors import InputError
from soar.perception.normal_files import CONVENTIONS
from tests.conftest import conf
from tests.perception.normal_scenes import returning_body
from tests.perception.test_normal_networks import sapiens_network
from tests.stages.test_normals import RECT, SCALE, run, write_sequence


def angles(got: np.ndarray, expected: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Degrees between int8 maps (T, H, W, 3) where ``inside`` and both show something."""
    both = inside & (np.abs(got).max(-1) > 0) & (np.abs(expected).max(-1) > 0)
    assert both.sum() > 0.9 * (inside & (np.abs(expected).max(-1) > 0)).sum() > 1000
    a, b = (v[both] / np.linalg.norm(v[both].astype(float), axis=-1, keepdims=True) for v in (got, expected))
    return np.rad2deg(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


@pytest.fixture
def scene(tmp_path: Path) -> tuple[Path, dict[str, np.ndarray], np.ndarray]:
    """The toy sequence, the body's own maps, and the masks."""
    write_sequence(tmp_path)
    maps, _ = run(tmp_path, "front")
    return tmp_path, maps, read_npz(tmp_path / "crops" / "front.npz")["alpha"] > 127


def test_icon(scene: tuple[Path, dict[str, np.ndarray], np.ndarray]) -> None:
    folder, expected, inside = scene
    network = returning_body(folder / "networks")
    maps, health = run(folder, "front", conf("normals", "icon") | {"device": "cpu"}, {"network": network})
    for side in ("front", "back"):
        found = angles(maps[side], expected[side], inside)
        assert np.median(found) < 1.5
        assert np.percentile(found, 95) < 6
        assert not maps[side][~inside].any()
    assert health.numbers["sign_test_failed"]["value"] == 0
    assert not health.remarks


def test_sapiens(scene: tuple[Path, dict[str, np.ndarray], np.ndarray]) -> None:
    folder, expected, inside = scene
    network = sapiens_network(folder / "sapiens.onnx")
    maps, health = run(folder, "front", conf("normals", "sapiens") | {"device": "cpu"}, {"network": network})
    np.testing.assert_array_equal(maps["back"][inside], expected["back"][inside])
    colours = read_npz(folder / "crops" / "front.npz")["rgb"][inside] / 127.5 - 1
    icon = maps["front"][inside] * np.array([1, -1, -1])
    cosine = (icon * colours).sum(-1) / np.linalg.norm(icon, axis=-1) / np.linalg.norm(colours, axis=-1)
    assert np.median(cosine) > 0.99  # this network takes colours for normals
    assert any("Camera front" in remark and "front only" in remark for remark in health.remarks)


def written(
    folder: Path, maps: dict[str, np.ndarray], ids: list[int], signs: tuple[int, ...], sides: tuple[str, ...]
) -> Path:
    """The maps as whole frames of twice the working resolution, as another program would have written them."""
    folder.mkdir()
    x0, y0, width, height = RECT
    for i, frame in enumerate(ids):
        for side in sides:
            whole = np.zeros((70, 80, 3), np.float32)
            whole[y0 : y0 + height, x0 : x0 + width] = maps[side][i] / np.float32(127)
            large = cv2.resize(whole, None, fx=1 / SCALE, fy=1 / SCALE, interpolation=cv2.INTER_NEAREST)
            coded = np.where(np.abs(large).max(-1, keepdims=True) > 0, (large * signs + 1) * 127.5, 0)
            cv2.imwrite(str(folder / f"{frame:06d}_{side}.png"), np.uint8(np.round(coded))[..., ::-1])
    return folder


@pytest.mark.parametrize("sides", [("front", "back"), ("front",)])
def test_files(scene: tuple[Path, dict[str, np.ndarray], np.ndarray], sides: tuple[str, ...]) -> None:
    folder, expected, inside = scene
    ids = read_json(folder / "sequence.json")["frame_ids"]
    source = written(folder / "maps", expected, ids, CONVENTIONS["dsine"], sides)
    maps, health = run(folder, "front", conf("normals", "files"), {"source": source})
    for side in ("front", "back"):
        assert np.percentile(angles(maps[side], expected[side], inside), 99) < 1
    assert health.numbers["sign_test_failed"]["value"] == 0
    said = " ".join(health.remarks)
    assert "dsine, stablenormal" in said
    assert ("front only" in said) == (len(sides) == 1)


def test_files_of_other_frames(scene: tuple[Path, dict[str, np.ndarray], np.ndarray]) -> None:
    folder, expected, _ = scene
    source = written(folder / "maps", expected, [0, 1, 2, 3], (1, 1, 1), ("front", "back"))
    with pytest.raises(InputError, match=r"no front for 4 of 4 frames(.*\n)*.*000010"):
        run(folder, "front", conf("normals", "files"), {"source": source})
