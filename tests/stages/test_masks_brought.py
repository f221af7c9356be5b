"""The masks stage with what users bring: masks of theirs, Segment Anything, a described network with a memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from soar.artifacts import ImageArchive, write_images
from soar.datasets import adapter
from soar.datasets.ingest import describe, stored_frames
from soar.errors import ConfigError, InputError
from soar.health import Health
from soar.perception.keypoints import Keypoints
from soar.stages import Job, masks
from tests.datasets.footage import node
from tests.perception.exports import masks_node, overlap, sam_pair, scene, video_finder

COUNT, ABSENT, SHAPE = 5, 2, (150, 260)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A clip of a person who stands still, absent in one frame, as the stages before leave it."""
    image, _, roi, body = scene(*SHAPE)
    (tmp_path / "clip").mkdir()
    for t in range(COUNT):
        cv2.imwrite(str(tmp_path / "clip" / f"{t}.png"), image[..., ::-1])
    capture = adapter(dataset(tmp_path)).capture("clip")
    sequence = describe(capture)
    sequence.write(tmp_path / "sequence.json")
    write_images(tmp_path / "camera.zip", stored_frames(capture, sequence, "camera"), ".png")
    points, regions = np.zeros((COUNT, 137, 3)), np.tile([roi.cx, roi.cy, roi.side, 0.0], (COUNT, 1))
    points[:, :25] = body
    points[ABSENT], regions[ABSENT] = 0, 0
    record = Keypoints(points, np.zeros((COUNT, 33, 3)), regions, np.ones(COUNT), np.zeros((COUNT, 25)))
    record.write(tmp_path / "k.npz")
    return tmp_path


def dataset(folder: Path) -> dict[str, Any]:
    return node("video", path=str(folder / "clip"), frames__min_frames=2, frames__fps=30.0)


def run(folder: Path, node: dict[str, Any], **brought: Path) -> tuple[list[np.ndarray], Health]:
    inputs = {"sequence": "sequence.json", "frames": "camera.zip", "keypoints": "k.npz", "models": "models"}
    outputs = {"masks": "m.zip", "health": "h.json", "evidence": "e.jpg"}
    paths = [{name: folder / file for name, file in files.items()} for files in (inputs, outputs)]
    masks.run(paths[0] | brought, paths[1], {"masks": node}, Job("clip", "camera", 0, 1, folder))
    assert paths[1]["evidence"].stat().st_size > 1000
    return [mask / 255 for mask in ImageArchive(folder / "m.zip")], Health.read(paths[1]["health"])


def files_node(folder: Path, **changes: Any) -> dict[str, Any]:
    options = masks_node("files", dataset=dataset(folder), **changes)
    del options["device"]
    return options


def test_files(folder: Path) -> None:
    truth = scene(*SHAPE)[1]
    (folder / "masks").mkdir()
    for t in range(COUNT):
        cv2.imwrite(str(folder / "masks" / f"{t}.png"), np.uint8(255 * np.roll(truth, t, 1)))
    found, health = run(folder, files_node(folder), source=folder / "masks")
    for t, mask in enumerate(found):  # in every frame, whether or not keypoints were found there
        np.testing.assert_array_equal(mask, np.roll(truth, t, 1))
    assert health.numbers["empty_frames"]["value"] == 0
    for t in range(COUNT):
        cv2.imwrite(str(folder / "masks" / f"{t}.png"), np.uint8(255 * ~truth))
    (folder / "m.zip").unlink()
    with pytest.raises(InputError, match="not on the person"):
        run(folder, files_node(folder), source=folder / "masks")
    assert not (folder / "m.zip").exists()
    with pytest.raises(ConfigError, match=r"masks\.source is not set"):
        run(folder, files_node(folder))


def test_segment_anything(folder: Path) -> None:
    found, health = run(folder, masks_node("mobile_sam"), **sam_pair(folder / "sam", "sam"))
    truth = scene(*SHAPE)[1]
    assert [overlap(mask, truth) > 0.95 for mask in found] == [t != ABSENT for t in range(COUNT)]
    assert health.numbers["empty_frames"]["value"] == 1 / COUNT


def test_a_network_with_a_memory_sees_the_frames_in_order(folder: Path) -> None:
    options = masks_node("rvm", size={"side": "long", "pixels": 260, "multiple_of": 1})
    found, _ = run(folder, options, network=video_finder(options, folder / "rvm.onnx"))
    truth = scene(*SHAPE)[1]
    levels = [0.6, 0.7, 0.0, 0.8, 0.9]
    np.testing.assert_allclose([mask[truth].max() for mask in found], levels, atol=0.003)


def test_a_described_network(folder: Path) -> None:
    from tests.perception.exports import finder

    options = masks_node("u2net", size=[96, 128])
    found, _ = run(folder, options, network=finder(options, folder / "n.onnx", ("input.1", "d0"), 7))
    assert overlap(found[0], scene(*SHAPE)[1]) > 0.9


def test_an_unknown_provider(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"unknown provider masks\.provider"):
        run(folder, {"provider": "magic"})
