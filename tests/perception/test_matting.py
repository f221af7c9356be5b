"""Described networks: every description in conf/masks on a network of known answer, and descriptions that are wrong."""

from __future__ import annotations

import numpy as np
import pytest

from soar.config import settings
from soar.errors import ConfigError, ModelFileError
from soar.perception.matting import NetworkSettings, _normalised
from soar.perception.registry import mask_provider
from tests.perception.exports import finder, masks_node, overlap, scene, video_finder

# Names of the input and of the first output, number of outputs, as the published files have them.
KNOWN = {
    "u2net": (("input.1", "d0"), 7),
    "isnet": (("input_image", "output_image"), 12),
    "birefnet": (("input_image", "output_image"), 1),
    "rmbg": (("pixel_values", "alphas"), 1),
    "modnet": (("input", "output"), 1),
    "pp_humanseg": (("x", "save_infer_model/scale_0.tmp_1"), 1),
}


def small(node):
    """The node with an input small enough for a test."""
    return node if isinstance(node["size"], dict) else node | {"size": [96, 128]}


def provider(node, path):
    return mask_provider(node, {"network": path}, 1)


def plain(**changes):
    """A description of our own, with the usual normalisation."""
    return masks_node("network", **changes)


@pytest.mark.parametrize("shape", [(150, 260), (260, 150)])
@pytest.mark.parametrize("option", KNOWN)
def test_known_networks(option, shape, tmp_path):
    node = small(masks_node(option))
    names, outputs = KNOWN[option]
    image, truth, roi, body = scene(*shape)
    alpha = provider(node, finder(node, tmp_path / "n.onnx", names, outputs))(image, roi, body)
    assert alpha.shape == shape
    assert alpha.dtype == np.float32
    assert 0 <= alpha.min() <= alpha.max() <= 1
    assert overlap(alpha, truth) > 0.9
    assert not alpha[:, round(0.6 * shape[1]) :].any()


@pytest.mark.parametrize(
    "changes",
    [
        {"resize": "letterbox"},
        {"resize": "letterbox", "size": [128, 96]},
        {"resize": "letterbox", "size": {"side": "long", "pixels": 150, "multiple_of": 32}},
        {"layout": "nhwc", "resize": "letterbox"},
        {"colours": "bgr"},
        {"layout": "nhwc", "colours": "bgr", "activation": "softmax", "channels": [1]},
        {"divide_by": "maximum", "mean": [0.5, 0.5, 0.5], "std": [1.0, 1.0, 1.0]},
        {"divide_by": 1.0, "mean": [123.0, 116.0, 103.0], "std": [58.0, 57.0, 57.0]},
        {"size": {"side": "short", "pixels": 100, "multiple_of": 16}, "activation": "sigmoid"},
    ],
)
@pytest.mark.parametrize("margin", [None, 1.1])
def test_every_way_to_feed_a_network(changes, margin, tmp_path):
    node = plain(**changes)
    node["region"] = node["region"] | {"margin": margin}
    image, truth, roi, body = scene(150, 260)
    for coarse in (1, 2):
        path = finder(node, tmp_path / f"{coarse}.onnx", ("in", "out"), coarse=coarse)
        assert overlap(provider(node, path)(image, roi, body), truth) > 0.88 + 0.05 * (coarse == 1)


def test_pixels_of_a_letterbox_are_where_they_were(tmp_path):
    """At the picture's own size nothing is resampled: the mask is exact, and the bars are the mean colour."""
    node = plain(resize="letterbox", size=[200, 260])
    node["region"] = node["region"] | {"margin": None, "fringe": 0.5}
    image, truth, roi, body = scene(150, 260)
    network = provider(node, finder(node, tmp_path / "n.onnx", ("in", "out")))
    seen, run = [], network._run
    network._run = lambda picture: seen.append(picture) or run(picture)
    alpha = network(image, roi, body)
    np.testing.assert_array_equal(alpha > 0.5, truth)
    assert seen[0].shape == (3, 200, 260)
    assert not seen[0][:, :25].any()
    assert not seen[0][:, 175:].any()
    assert seen[0][:, 25].any()


def test_stretching_and_multiples(tmp_path):
    node = plain(size={"side": "short", "pixels": 100, "multiple_of": 32})
    node["region"] = node["region"] | {"margin": None}
    image, _, roi, body = scene(150, 260)
    network = provider(node, finder(node, tmp_path / "n.onnx", ("in", "out")))
    seen, run = [], network._run
    network._run = lambda picture: seen.append(picture.shape) or run(picture)
    network(image, roi, body)
    assert seen == [(3, 96, 160)]  # 100 and 173.3, to the nearest multiples of 32


def test_normalisation():
    picture = np.array([[[200, 100, 50], [20, 10, 160]]], np.uint8)

    def given(**changes):
        return _normalised(settings(NetworkSettings, plain(**changes), "masks"), picture)[0, 0]

    mean, std = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    np.testing.assert_allclose(given(), (np.array([200, 100, 50]) / 255 - mean) / std, rtol=1e-5)
    np.testing.assert_allclose(given(divide_by="maximum"), (np.array([1, 0.5, 0.25]) - mean) / std, rtol=1e-5)
    np.testing.assert_allclose(given(colours="bgr"), (np.array([50, 100, 200]) / 255 - mean) / std, rtol=1e-5)
    plain_numbers = given(divide_by=1, mean=[0.0, 0.0, 0.0], std=[1.0, 1.0, 1.0])
    np.testing.assert_array_equal(plain_numbers, [200, 100, 50])


def test_nobody_is_not_made_of_noise(tmp_path):
    """A map that is nowhere bright is not stretched to a person."""
    node = small(masks_node("u2net"))
    image, _, roi, body = scene(150, 260)
    network = provider(node, finder(node, tmp_path / "n.onnx", ("input.1", "d0"), 7))
    assert network(image, roi, body).any()
    assert not network(image[..., ::-1], roi, body)[:, :110].any()  # only the person is blue, and dark in red
    dim = masks_node("u2net", size=[96, 128], activation={"minmax_above": 0.95})
    assert not provider(dim, tmp_path / "n.onnx")(image, roi, body).any()


def test_states_pass_from_frame_to_frame(tmp_path):
    node = masks_node("rvm", size={"side": "long", "pixels": 260, "multiple_of": 1})
    path = video_finder(node, tmp_path / "rvm.onnx")
    image, truth, roi, body = scene(150, 260)
    network = provider(node, path)
    for count in (1, 2, 3):
        alpha = network(image, roi, body)
        assert alpha[truth].max() == pytest.approx(0.5 + 0.1 * count, abs=1e-5)
        assert overlap(alpha, truth) > 0.95
    assert provider(node, path)(image, roi, body)[truth].max() == pytest.approx(0.6, abs=1e-5)  # another clip
    other = provider(node | {"constants": {"downsample_ratio": [0.4]}}, path)
    assert not other(image, roi, body).any()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"input": "src"}, "a picture src"),
        ({"size": [64, 64]}, "[1, 3, 64, 64]"),
        ({"size": {"side": "long", "pixels": 64, "multiple_of": 32}}, "[1, 3, free, free]"),
        ({"layout": "nhwc"}, "[1, 96, 128, 3]"),
        ({"output": "pha"}, "output pha"),
        ({"output": 3}, "output 3"),
        ({"states": {"r1i": "r1o"}}, "r1i"),
        ({"constants": {"ratio": [1.0]}}, "ratio"),
    ],
)
def test_another_network_than_described(changes, says, tmp_path):
    path = finder(plain(), tmp_path / "n.onnx", ("in", "out"))
    node = plain(**changes)
    node["region"] = node["region"] | {"margin": None}
    with pytest.raises(ModelFileError, match="not the network") as error:
        provider(node, path)
    assert says in error.value.expected
    assert "takes in [1, 3, 96, 128] (float); gives out [1, 1, 96, 128]" in error.value.got


@pytest.mark.parametrize(
    ("activation", "told"), [("none", "sigmoid"), ("sigmoid", "none"), ("softmax", "none"), ("none", "softmax")]
)
def test_another_activation_than_described(activation, told, tmp_path):
    """Alpha taken for logits, or logits for alpha, would look like a mask."""
    channels = {"channels": [1]} if "softmax" in (activation, told) else {}
    made = plain(activation=activation, **channels)
    image, _, roi, body = scene(150, 260)
    alpha_twice = told == "softmax"
    path = _probabilities(tmp_path) if alpha_twice else finder(made, tmp_path / "n.onnx", ("in", "out"))
    with pytest.raises(ModelFileError, match=r"correct masks\.activation"):
        provider(plain(activation=told, **channels), path)(image, roi, body)


def _probabilities(folder):
    import torch

    from tests.perception.exports import export

    class Two(torch.nn.Module):
        def forward(self, picture):
            person = picture[:, :1].sigmoid()
            return torch.cat([1 - person, person], 1)

    return export(Two(), folder / "two.onnx", {"in": torch.rand(1, 3, 96, 128)}, ["out"])


def test_channels_that_are_not_there(tmp_path):
    path = finder(plain(), tmp_path / "n.onnx", ("in", "out"))
    image, _, roi, body = scene(150, 260)
    with pytest.raises(ModelFileError, match=r"it gave \(1, 96, 128\)"):
        provider(plain(channels=[1]), path)(image, roi, body)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"states": {"r1i": "r1o"}}, r"masks\.region\.margin"),
        ({"channels": []}, r"masks\.channels"),
        ({"std": [1.0, 0.0, 1.0]}, r"masks\.std"),
        ({"divide_by": 0}, r"masks\.divide_by"),
        ({"resize": "crop"}, r"masks\.resize"),
        ({"activation": "tanh"}, r"masks\.activation"),
    ],
)
def test_descriptions_that_contradict_themselves(changes, says, tmp_path):
    with pytest.raises(ConfigError, match=says):
        provider(plain(**changes), tmp_path / "n.onnx")


def test_nothing_is_brought():
    with pytest.raises(ConfigError, match=r"masks\.network is not set"):
        mask_provider(plain(), {}, 1)
