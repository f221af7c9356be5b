"""The calibration schema: what it accepts, converts and refuses; sizes; the Qualisys reader's golden numbers."""

from __future__ import annotations

import contextlib
import copy
import json

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from soar.datasets.calibration import intrinsic_matrix, match_size, parse_calibration
from soar.datasets.qualisys import read_qualisys
from soar.datasets.recordings import Probe
from soar.errors import CalibrationError
from tests.conftest import ROOT
from tests.datasets.footage import camera_entry

GOOD = {"units": "metres", "up": [0, 0, 2], "fps": 50, "cameras": {"left": camera_entry(), "right": camera_entry(5.0)}}


def test_parse():
    parsed = parse_calibration(GOOD, "rig.json")
    assert list(parsed.cameras) == ["left", "right"]
    np.testing.assert_array_equal(parsed.up, (0, 0, 1))
    assert parsed.fps == 50
    left = parsed.cameras["left"]
    np.testing.assert_allclose(left.centre, (0, -4, 0))
    np.testing.assert_array_equal(left.K, [[100, 0, 48], [0, 101, 32], [0, 0, 1]])
    assert "rig.json" in left.K_source


def test_opencv_pixel_centres_are_shifted():
    left = parse_calibration(GOOD | {"pixel_centre": 0}, "rig.json").cameras["left"]
    np.testing.assert_array_equal(left.K[:2, 2], (48.5, 32.5))


def test_missing_up_is_remarked():
    parsed = parse_calibration({"cameras": GOOD["cameras"]}, "rig.json")
    np.testing.assert_array_equal(parsed.up, (0, 0, 1))
    assert "up axis" in parsed.remarks[0]


def _left_handed() -> list[list[float]]:
    T = np.array(camera_entry()["T_cam_from_world"])
    T[0, :3] *= -1
    return T.tolist()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("K", [[100, 0], [0, 100]], "left: K"),
        ("K", [100, 100, float("nan"), 32], "left: K"),
        ("K", [[100, 3, 48], [0, 100, 32], [0, 0, 1]], "left: K"),
        ("K", [-100, 100, 48, 32], "left: focal length"),
        ("size", [96], "left: size"),
        ("size", "96x64", "left: size"),
        ("size", [96.5, 64], "left: size"),
        ("size", [0, 64], "left: size"),
        ("distortion", [0.1, 0.2, 0, 0, 0, 0, 0, 0], "left: distortion"),
        ("T_cam_from_world", _left_handed(), "left: the upper 3x3"),
        ("T_cam_from_world", np.eye(3).tolist(), "left: T_cam_from_world"),
        ("T_cam_from_world", np.eye(4).T[::-1].tolist(), "left: T_cam_from_world"),
        ("focal", 3, "camera left does not fit"),
    ],
)
def test_camera_errors_name_camera_and_field(field, value, message):
    bad = copy.deepcopy(GOOD)
    bad["cameras"]["left"][field] = value
    with pytest.raises(CalibrationError, match=message):
        parse_calibration(bad, "rig.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"units": "millimetres"}, "units"),
        ({"up": [0, 0, 0]}, "up"),
        ({"up": "z"}, "up"),
        ({"fps": 0}, "fps"),
        ({"pixel_centre": 1}, "pixel_centre"),
        ({"scale": 2}, "unknown scale"),
        ({"cameras": {}}, "cameras"),
        ({"cameras": {"../left": camera_entry()}}, "camera names"),
        ({"cameras": {"a": camera_entry(4000.0), "b": camera_entry(5000.0)}}, "1000 m apart"),
    ],
)
def test_file_errors(change, message):
    with pytest.raises(CalibrationError, match=message):
        parse_calibration(GOOD | change, "rig.json")


def test_missing_key_is_named():
    bad = copy.deepcopy(GOOD)
    del bad["cameras"]["right"]["size"]
    with pytest.raises(CalibrationError, match="camera right") as caught:
        parse_calibration(bad, "rig.json")
    assert "missing size" in str(caught.value)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
FIELDS = ("units", "up", "fps", "pixel_centre", "cameras")
CAMERA_FIELDS = ("size", "K", "distortion", "T_cam_from_world", "source")


@hypothesis.settings(max_examples=300, deadline=None)
@hypothesis.given(field=st.sampled_from([*FIELDS, *CAMERA_FIELDS, ""]), value=JSON)
def test_whatever_stands_in_a_field_is_accepted_or_named(field, value):
    changed = copy.deepcopy(GOOD)
    if field in FIELDS:
        changed[field] = value
    elif field:
        changed["cameras"]["left"][field] = value
    else:
        changed = value
    with contextlib.suppress(CalibrationError):
        for camera in parse_calibration(changed, "rig.json").cameras.values():
            assert np.isfinite(camera.K).all()


def test_both_forms_of_intrinsics_agree():
    rows = intrinsic_matrix([[100, 0, 48], [0, 101, 32], [0, 0, 1]], "x")
    np.testing.assert_array_equal(rows, intrinsic_matrix([100, 101, 48, 32], "x"))


def test_match_size():
    camera = parse_calibration(GOOD, "rig.json").cameras["left"]

    def probe(width: int, height: int) -> Probe:
        return Probe(width, height, 10, 30.0, None)

    assert match_size(camera, probe(96, 64), "error") == (camera, None)
    with pytest.raises(CalibrationError, match="left: frames are 92x64"):
        match_size(camera, probe(92, 64), "error")
    cropped, remark = match_size(camera, probe(92, 64), "crop")
    assert (cropped.width, cropped.height) == (92, 64)
    np.testing.assert_array_equal(cropped.K, camera.K)
    assert "92x64" in remark
    with pytest.raises(CalibrationError):
        match_size(camera, probe(100, 64), "crop")
    resized, _ = match_size(camera, probe(48, 32), "resize")
    np.testing.assert_allclose(resized.K[:2], camera.K[:2] / 2)
    with pytest.raises(CalibrationError, match="left"):
        match_size(camera, probe(48, 48), "resize")


QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration source="made up"><cameras>
<camera serial="c7"><fov_video left="0" top="0" right="639" bottom="479"/>
<transform r11="0" r12="1" r13="0" r21="-1" r22="0" r23="0" r31="0" r32="0" r33="1" x="1000" y="-2000" z="3000"/>
<intrinsic centerPointU="20480" centerPointV="15360" focalLengthU="32000" focalLengthV="32064"
 radialDistortion1="-0.05" radialDistortion2="0.14" radialDistortion3="0.01"
 tangentalDistortion1="0.001" tangentalDistortion2="-0.002"/></camera></cameras></calibration>"""


def test_qualisys_golden_numbers(tmp_path):
    path = tmp_path / "a.qca.txt"
    path.write_text(QUALISYS)
    camera = parse_calibration(read_qualisys(path), path.name).cameras["c7"]
    assert (camera.width, camera.height) == (640, 480)
    np.testing.assert_array_equal(camera.K, [[500, 0, 320], [0, 501, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, (-0.05, 0.14, 0.001, -0.002, 0.01))
    np.testing.assert_array_equal(camera.R, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    np.testing.assert_allclose(camera.centre, (1, -2, 3))
    # Straight below the camera, 3 m away: on the optical axis.
    np.testing.assert_allclose(camera.project(np.array([1.0, -2.0, 0.0])), (320, 240))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<calibration>", "not XML"),
        ("<calibration/>", "no camera"),
        ('<!DOCTYPE a [<!ENTITY b "cc">]><calibration>&b;</calibration>', "document type"),
        (QUALISYS.replace("focalLengthU", "focal"), "c7.*<intrinsic>.*focalLengthU"),
        (QUALISYS.replace('r11="0"', 'r11="zero"'), "c7.*<transform>"),
        (QUALISYS.replace("fov_video", "fov"), "c7 has no <fov_video>"),
        (QUALISYS.replace(' serial="c7"', ""), "no serial"),
    ],
)
def test_qualisys_errors(tmp_path, text, message):
    path = tmp_path / "a.qca.txt"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_qualisys(path)


def test_qualisys_missing(tmp_path):
    with pytest.raises(CalibrationError, match="does not exist"):
        read_qualisys(tmp_path / "none")


def test_the_documented_example_is_valid():
    text = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")
    example = text.partition("```json\n")[2].partition("```")[0]
    parsed = parse_calibration(json.loads(example), "example")
    assert list(parsed.cameras) == ["cam01", "cam02"]
    assert parsed.remarks == ()
