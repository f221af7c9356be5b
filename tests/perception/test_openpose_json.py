"""Files of OpenPose: what they hold, which frame they belong to, in which unit, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soar.body.openpose import BODY, FACE, INDEX, LEFT_HAND, RIGHT_HAND
from soar.errors import InputError
from soar.geometry.cameras import Camera
from soar.perception.openpose_json import LARGEST, in_pixels, read_folder, read_people

CAMERA = Camera("a", 640, 480, np.diag([500.0, 500, 1]), np.eye(4), np.zeros(5), "test")


def person(keypoints: np.ndarray, hands_and_face: bool = True, **changes: Any) -> dict[str, Any]:
    """An entry of ``people`` as OpenPose 1.7 writes it, of keypoints (137, 3)."""
    rest = keypoints if hands_and_face else keypoints[:0]
    return {
        "person_id": [-1],
        "pose_keypoints_2d": keypoints[: len(BODY)].ravel().tolist(),
        "face_keypoints_2d": rest[FACE].ravel().tolist(),
        "hand_left_keypoints_2d": rest[LEFT_HAND].ravel().tolist(),
        "hand_right_keypoints_2d": rest[RIGHT_HAND].ravel().tolist(),
        "pose_keypoints_3d": [], "face_keypoints_3d": [], "hand_left_keypoints_3d": [], "hand_right_keypoints_3d": [],
    } | changes  # fmt: skip


def write(file: Path, *people: dict[str, Any], version: float = 1.3) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"version": version, "people": list(people)}), encoding="utf-8")
    return file


@pytest.fixture
def keypoints() -> np.ndarray:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(100, 400, (137, 2)), rng.uniform(0.2, 1, 137)])
    points[[4, 50]] = 0  # not detected
    return points


def test_people_in_the_order_of_the_137(tmp_path: Path, keypoints: np.ndarray) -> None:
    other = keypoints + np.array([5, 0, 0])
    found = read_people(write(tmp_path / "v_keypoints.json", person(keypoints), person(other)))
    assert found.shape == (2, 137, 3)
    np.testing.assert_array_equal(found[0], keypoints)
    assert not found[1, 4].any()  # a place without confidence is none
    np.testing.assert_array_equal(found[1, FACE], other[FACE])


@pytest.mark.parametrize("version", [1.0, 1.2, 1.3])
def test_hands_and_face_may_be_missing(tmp_path: Path, keypoints: np.ndarray, version: float) -> None:
    entry = person(keypoints, hands_and_face=False)
    for key in [k for k in entry if "3d" in k or k == "person_id"]:
        del entry[key]
    found = read_people(write(tmp_path / "v_keypoints.json", entry, version=version))
    np.testing.assert_array_equal(found[0, : len(BODY)], keypoints[: len(BODY)])
    assert not found[0, len(BODY) :].any()
    del entry["hand_left_keypoints_2d"]
    assert read_people(write(tmp_path / "w_keypoints.json", entry)).shape == (1, 137, 3)


def test_nobody(tmp_path: Path) -> None:
    assert read_people(write(tmp_path / "v_keypoints.json")).shape == (0, 137, 3)


@pytest.mark.parametrize(
    ("count", "name"), [(54, "18 keypoints"), (45, "15 keypoints"), (0, "no body"), (51, "51 numbers")]
)
def test_models_of_fewer_keypoints_are_refused_by_name(
    tmp_path: Path, keypoints: np.ndarray, count: int, name: str
) -> None:
    file = write(tmp_path / "v_keypoints.json", person(keypoints, pose_keypoints_2d=[1.0] * count))
    with pytest.raises(InputError, match=name) as error:
        read_people(file)
    assert "BODY_25" in error.value.cure


@pytest.mark.parametrize(
    "content",
    [
        "", "{", "[1, 2]", '{"people": 3}', '{"people": [3]}', '{"version": 1.3}', "[" * 100_000,
        '{"people": [{"pose_keypoints_2d": "x"}]}', '{"people": [{"pose_keypoints_2d": [[1], [2, 3]]}]}',
        '{"people": [{"pose_keypoints_2d": {"a": 1}}]}',
        '{"people": [{"pose_keypoints_2d": [' + ",".join(["NaN"] * 75) + "]}]}",
        '{"people": [{"pose_keypoints_2d": [' + ",".join(["1" + "0" * 400] * 75) + "]}]}",
        '{"people": [{"pose_keypoints_2d": [' + ",".join(["null"] * 75) + "]}]}",
    ],
)  # fmt: skip
def test_damaged_files_are_named(tmp_path: Path, content: str) -> None:
    file = tmp_path / "v_keypoints.json"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="v_keypoints"):
        read_people(file)


def test_binary_and_absurdly_large_files_are_named(tmp_path: Path) -> None:
    file = tmp_path / "v_keypoints.json"
    file.write_bytes(b"\x80\x04\x95\xff")
    with pytest.raises(InputError, match="not JSON"):
        read_people(file)
    with open(file, "wb") as stream:
        stream.truncate(LARGEST + 1)
    with pytest.raises(InputError, match="too large"):
        read_people(file)


def test_numbers_in_file_names(tmp_path: Path) -> None:
    for name in ("clip_000000000007", "clip_000000000012", "clip_9"):
        write(tmp_path / f"{name}_keypoints.json")
    (tmp_path / "notes.txt").touch()
    assert {number: file.name for number, file in read_folder(tmp_path).items()} == {
        7: "clip_000000000007_keypoints.json", 12: "clip_000000000012_keypoints.json", 9: "clip_9_keypoints.json",
    }  # fmt: skip
    write(tmp_path / "other_0012_keypoints.json")
    with pytest.raises(InputError, match="the same number"):
        read_folder(tmp_path)


@pytest.mark.parametrize("name", ["", "clip_keypoints.json", "clip_0001.json"])
def test_folders_of_something_else(tmp_path: Path, name: str) -> None:
    if name:
        (tmp_path / name).touch()
    with pytest.raises(InputError, match="has no number" if "keypoints" in name else "no folder of OpenPose"):
        read_folder(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        read_folder(tmp_path / "none")


def test_shares_of_the_picture_are_recognised(keypoints: np.ndarray) -> None:
    size = np.array([640.0, 480])
    seen = keypoints[:, 2:] > 0
    shares = np.concatenate([keypoints[:, :2] / size * seen, keypoints[:, 2:]], 1)[None]
    centred = np.concatenate([(keypoints[:, :2] / size * 2 - 1) * seen, keypoints[:, 2:]], 1)[None]
    empty = np.zeros((0, 137, 3))
    for given, word in ((shares, "from 0 to 1"), (centred, "from -1 to 1")):
        people, unit = in_pixels([given, empty], CAMERA)
        assert word in unit
        np.testing.assert_allclose(people[0][0], keypoints, atol=1e-9)
    people, unit = in_pixels([keypoints[None], empty], CAMERA)
    assert unit == ""
    assert people[0][0, INDEX["nose"], 0] == keypoints[0, 0]
    assert in_pixels([empty], CAMERA)[1] == ""
