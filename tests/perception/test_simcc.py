"""SimCC networks: crops, decoding, both passes, batches; what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from soar.body.openpose import BODY, INDEX, LIMBS
from soar.config import settings
from soar.errors import ConfigError, InputError, ModelFileError
from soar.perception import lift, simcc
from soar.perception.detector import Person
from soar.perception.keypoints import Choice, Keypoints, TrackReport
from soar.perception.roi import Roi
from soar.perception.simcc import SimccKeypoints, SimccNetwork, SimccSettings, crop
from soar.perception.wholebody import BODY_AND_FEET, openpose_137
from tests.perception.exports import export
from tests.perception.marionette import (
    BOX,
    HEIGHT,
    RADIUS,
    WIDTH,
    KnownPose,
    detector,
    dot_finder,
    frame,
    node,
    truth,
)

COUNT = 4
PEOPLE = np.stack([truth(t) for t in range(COUNT)])
FRAMES = [frame(t, dots) for t, dots in enumerate(PEOPLE)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("networks")
    boxes = detector(folder / "yolox.onnx", [(*BOX, 0.9), (*BOX * 0.2, 0.5)])
    return {"network": dot_finder(folder / "dots.onnx"), "detector": boxes, "models": folder}


def _provider(
    files: dict[str, Path], monkeypatch: pytest.MonkeyPatch, known: KnownPose | None = None, **changes: object
) -> SimccKeypoints:
    """A provider with somebody who knows the person in BlazePose's place."""
    pose = known or KnownPose(PEOPLE)
    monkeypatch.setattr(simcc, "PoseNetwork", lambda path, threads: pose)
    options = settings(SimccSettings, node("rtmw", device="cpu", batch=3, **changes), "keypoints")
    return SimccKeypoints(options, files, 1)


def _estimate(provider: SimccKeypoints, frames: list[np.ndarray] = FRAMES) -> tuple[Keypoints, TrackReport]:
    return provider(frames, None)


@pytest.mark.parametrize("mirrored", [True, False])
def test_dots_are_found_where_they_were_drawn(files, monkeypatch, mirrored):
    record, report = _estimate(_provider(files, monkeypatch, mirrored=mirrored))
    expected = openpose_137(PEOPLE)
    error = np.linalg.norm(record.keypoints[..., :2] - expected[..., :2], axis=-1)
    # A pixel of the crop is 1.9 pixels of the frame.
    assert error.max() < 2.0
    assert np.median(error) < 1.0
    assert (record.keypoints[..., 2] > 0.4).all()
    assert record.keypoints[..., 2].max() <= 1
    assert record.present.all()
    assert not report.swapped.any()
    if mirrored:
        assert 0 < record.disagreement.max() < 3
        assert abs((record.keypoints - expected)[..., :2].mean()) < 0.3  # both passes' errors cancel
    else:
        assert not record.disagreement.any()


def test_the_rest_of_the_record(files, monkeypatch):
    record, report = _estimate(_provider(files, monkeypatch))
    body = record.keypoints[0, : len(BODY)]
    assert np.linalg.norm(record.roi[:, :2] - record.keypoints[:, INDEX["mid_hip"], :2], axis=1).max() < 1.0
    reach = np.linalg.norm(body[:, :2] - body[INDEX["mid_hip"], :2], axis=1).max()
    assert record.roi[0, 2] == pytest.approx(2 * 1.25 * reach, rel=0.01)
    assert abs(record.roi[:, 3]).max() < 0.02
    known = KnownPose(PEOPLE)
    for t in range(COUNT):
        assert np.allclose(record.world[t], known(FRAMES[t], Roi(0, 0, 1, 0)).world, atol=1e-6)
    assert record.score == pytest.approx(record.keypoints[:, list(LIMBS), 2].mean(1))
    assert report.start == 0
    assert report.remarks == ()


def test_frames_one_by_one_are_the_same(files, monkeypatch, tmp_path):
    together, _ = _estimate(_provider(files, monkeypatch))
    alone, _ = _estimate(_provider(files | {"network": dot_finder(tmp_path / "one.onnx", free=False)}, monkeypatch))
    np.testing.assert_allclose(alone.keypoints, together.keypoints, atol=1e-4)


def test_boxes_from_mediapipe(files, monkeypatch):
    """Without a detector of one's own: MediaPipe's, and its landmarks to follow; the box is the one around them."""
    pose = KnownPose(PEOPLE)
    monkeypatch.setattr(simcc, "PersonDetector", lambda *_: lambda image: [Person(0.9, Roi(250, 240, 450, 0.0))])
    ours = {key: path for key, path in files.items() if key != "detector"}
    # The dots of hands and face are beside the body, and the box is the body's.
    provider = _provider(ours, monkeypatch, pose, landmark_margin=0.6)
    record, _ = _estimate(provider)
    assert np.linalg.norm(record.keypoints - openpose_137(PEOPLE), axis=-1)[:, : len(BODY)].max() < 3
    assert len(pose.asked) == 2 * COUNT  # to follow, and to lift


def test_the_users_word_chooses_among_the_boxes(files, monkeypatch):
    small = BOX * 0.2
    provider = _provider(files, monkeypatch)
    boxes = provider._followed(FRAMES, Choice(1, (float(small[::2].mean()), float(small[1::2].mean())), None))[1]
    np.testing.assert_allclose(boxes[0], small, rtol=1e-5)
    np.testing.assert_allclose(provider._followed(FRAMES, None)[1][0], BOX, rtol=1e-5)


def _exchanged(dots: np.ndarray, parts: tuple[str, ...]) -> np.ndarray:
    out = dots.copy()
    for i, name in enumerate(BODY_AND_FEET):
        if name.startswith("left_") and name.endswith(parts):
            j = BODY_AND_FEET.index(name.replace("left_", "right_"))
            out[[i, j]] = dots[[j, i]]
    return out


def test_sides_that_a_frame_exchanges_are_set_right(files, monkeypatch):
    legs = ("hip", "knee", "ankle", "heel", "toe")
    frames = [frame(t, _exchanged(d, legs) if t == 2 else d) for t, d in enumerate(PEOPLE)]
    record, report = _estimate(_provider(files, monkeypatch), frames)
    assert report.swapped.tolist() == [[False, False, t == 2] for t in range(COUNT)]
    expected = openpose_137(PEOPLE)
    assert np.linalg.norm((record.keypoints - expected)[..., :2], axis=-1).max() < 2.0
    known = KnownPose(PEOPLE)
    assert np.allclose(record.world[2], known(FRAMES[2], Roi(0, 0, 1, 0)).world, atol=1e-6)


def test_where_blazepose_sees_somebody_else_there_are_no_metres(files, monkeypatch):
    elsewhere = PEOPLE.copy()
    elsewhere[1, :, 0] += 150
    record, report = _estimate(_provider(files, monkeypatch, KnownPose(elsewhere, absent=(3,))))
    assert record.present.all()
    assert [world.any() for world in record.world] == [True, False, True, False]
    assert report.remarks == ("In 2 of 4 frames there are no metric landmarks: BlazePose does not see the person.",)
    with pytest.raises(InputError, match="do not lie on the person"):
        _estimate(_provider(files, monkeypatch, KnownPose(elsewhere + np.array([150, 0, 0]))))


def test_a_crop_has_the_shape_of_the_input_and_the_margin_all_round():
    tall = crop(np.array([100, 50, 200, 450.0]), 288, 384, 1.25)
    assert tall.scale == pytest.approx(400 * 1.25 / 384)
    wide = crop(np.array([100, 50, 500, 150.0]), 288, 384, 1.25)
    assert wide.scale == pytest.approx(400 * 1.25 / 288)
    matrix = wide.matrix(288, 384)
    np.testing.assert_allclose(matrix @ (144, 192, 1), (300, 100))
    np.testing.assert_allclose(matrix @ (0, 192, 1), (300 - 250, 100))


def test_preprocessing_is_rgb_normalised_black_outside(tmp_path):
    """A network that reports its input: mean colours as the maxima of the first keypoints."""

    class Echo(nn.Module):
        def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
            means = x.mean((2, 3)).repeat(1, 45)[:, :133, None]
            return means.repeat(1, 1, 96), means.repeat(1, 1, 128)

    path = export(Echo(), tmp_path / "echo.onnx", {"input": torch.zeros(1, 3, 64, 48)}, ["simcc_x", "simcc_y"])
    network = SimccNetwork(path, 1, "cpu")
    image = np.zeros((1, 64, 48, 3), np.uint8)
    image[:] = (140, 128, 250)
    found = network(image)[0, :3, 2]
    np.testing.assert_allclose(found, [(140 - 123.675) / 58.395, (128 - 116.28) / 57.12, 1.0], rtol=1e-4)
    assert not network(image * 0)[0, :3, 2].any()  # below zero counts as zero
    seen = simcc._sampled(
        np.full((50, 50, 3), 255, np.uint8), crop(np.array([0, 0, 50, 50.0]), 48, 64, 2.0).matrix(48, 64), (48, 64)
    )
    assert seen[32, 24].tolist() == [255] * 3
    assert not seen[:8].any()


def test_scores_beyond_one_count_as_one(tmp_path):
    network = SimccNetwork(dot_finder(tmp_path / "loud.onnx", (192, 144), gain=40.0), 1, "cpu")
    crops = cv2.resize(FRAMES[0], (144, 192), interpolation=cv2.INTER_NEAREST)[None]
    assert network(crops)[..., 2].max() == 1.0


@pytest.mark.parametrize("free", [True, False])
def test_sizes_of_published_networks(tmp_path, free):
    """288 x 384 pixels in, 576 and 768 places out, of a network of random weights."""

    class Random(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.conv = nn.Conv2d(3, 133, 3, stride=16)
            self.x, self.y = nn.Linear(24 * 18, 576), nn.Linear(24 * 18, 768)

        def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
            features = self.conv(nn.functional.pad(x, (1, 1, 1, 1))).flatten(2)
            return self.x(features), self.y(features)

    axes = {name: {0: "batch"} for name in ("input", "simcc_x", "simcc_y")} if free else {}
    torch.manual_seed(0)
    path = export(Random(), tmp_path / "r.onnx", {"input": torch.zeros(1, 3, 384, 288)}, ["simcc_x", "simcc_y"], **axes)
    network = SimccNetwork(path, 1, "cpu")
    assert (network.batched, network.height, network.width) == (free, 384, 288)
    noise = np.random.default_rng(0).integers(0, 256, (3, 384, 288, 3), np.uint8)
    found = network(noise)
    assert found.shape == (3, 133, 3)
    assert ((found >= 0) & (found <= (288, 384, 1))).all()
    np.testing.assert_allclose(found[1], network(noise[1:2])[0], atol=1e-5)


def test_networks_of_the_body_alone_are_refused(tmp_path):
    with pytest.raises(ModelFileError, match="not the network") as error:
        SimccNetwork(dot_finder(tmp_path / "body.onnx", (64, 48), free=False, keypoints=17), 1, "cpu")
    assert "133" in error.value.expected
    assert "17" in error.value.got
    # Where the file does not tell, its answer does.
    network = SimccNetwork(dot_finder(tmp_path / "untold.onnx", (64, 48), keypoints=17), 1, "cpu")
    with pytest.raises(ModelFileError, match=r"it gave \(1, 17, 96\)"):
        network(np.zeros((1, 64, 48, 3), np.uint8))


def test_other_networks_and_damaged_files_are_refused(tmp_path, files):
    with pytest.raises(ModelFileError, match="not the network"):
        SimccNetwork(files["detector"], 1, "cpu")
    (tmp_path / "cut.onnx").write_bytes(files["network"].read_bytes()[:1000])
    with pytest.raises(ModelFileError):
        SimccNetwork(tmp_path / "cut.onnx", 1, "cpu")
    with pytest.raises(ModelFileError, match="missing"):
        SimccNetwork(tmp_path / "none.onnx", 1, "cpu")
    odd = nn.Module()
    odd.forward = lambda x: (x.mean((1, 2))[:, None].repeat(1, 133, 2), x.mean((1, 3))[:, None].repeat(1, 133, 3))  # type: ignore[method-assign]
    export(odd, tmp_path / "odd.onnx", {"input": torch.zeros(1, 3, 64, 48)}, ["simcc_x", "simcc_y"])
    with pytest.raises(ModelFileError, match=r"it gave \(1, 133, 96\) and \(1, 133, 192\)"):
        SimccNetwork(tmp_path / "odd.onnx", 1, "cpu")(np.zeros((1, 64, 48, 3), np.uint8))


def test_a_network_must_be_named(files, monkeypatch):
    with pytest.raises(ConfigError, match=r"keypoints\.network is not set"):
        _provider({"models": files["models"]}, monkeypatch)


def test_region_of_a_body_that_is_partly_seen():
    body = openpose_137(PEOPLE[0])[: len(BODY)]
    whole = lift.body_region(body)
    hidden = body.copy()
    hidden[[INDEX["mid_hip"], INDEX["neck"]]] = 0  # their neighbours stand in
    assert lift.body_region(hidden) == whole
    legless = body.copy()
    legless[
        [i for name, i in INDEX.items() if i < 25 and any(p in name for p in ("hip", "knee", "ankle", "toe", "heel"))]
    ] = 0
    upper = lift.body_region(legless)
    seen = legless[legless[:, 2] > 0, :2]
    assert (upper.cx, upper.cy) == pytest.approx((seen.min(0) + seen.max(0)) / 2)
    assert upper.rotation == 0
    assert all(upper.contains(*point) for point in seen)
    one = np.zeros((25, 3))
    assert lift.body_region(one) is None
    one[3] = 10, 20, 1
    assert lift.body_region(one) is None


def test_dots_do_not_meet():
    gaps = np.linalg.norm(PEOPLE[0, :, None, :2] - PEOPLE[0, None, :, :2], axis=-1) + 1e3 * np.eye(133)
    assert gaps.min() > 2 * RADIUS
    assert ((PEOPLE[..., :2] > 0) & (PEOPLE[..., :2] < (WIDTH, HEIGHT))).all()
