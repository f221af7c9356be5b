"""Segment Anything in the exports that people have: prompts, coordinates, the choice of a mask, pairs that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from soar.errors import ConfigError, ModelFileError
from soar.perception.registry import mask_provider
from soar.perception.roi import Roi
from soar.perception.sam import _chosen, padded, stretched, with_own_preprocessing
from tests.perception import exports
from tests.perception.exports import export, masks_node, overlap, sam_pair, scene

KINDS = ("sam", "sam_own", "sam_fixed", "sam2", "sam2_runtime")
OPTION = {"sam": "sam", "sam_own": "mobile_sam", "sam_fixed": "sam", "sam2": "sam2", "sam2_runtime": "sam2"}


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> dict[str, dict[str, Path]]:
    return {kind: sam_pair(tmp_path_factory.mktemp(kind), kind) for kind in KINDS}


def provider(option: str, files: dict[str, Path], margin: float | None = 1.1, **changes):
    node = masks_node(option, **changes)
    return mask_provider(node | {"region": node["region"] | {"margin": margin}}, files, 1)


@pytest.mark.parametrize("margin", [1.1, None])
@pytest.mark.parametrize("shape", [(150, 260), (260, 150)])
@pytest.mark.parametrize("kind", KINDS)
def test_the_person_is_found_where_they_are(pairs, kind, shape, margin):
    image, truth, roi, body = scene(*shape)
    alpha = provider(OPTION[kind], pairs[kind], margin)(image, roi, body)
    assert alpha.shape == shape
    assert alpha.dtype == np.float32
    assert 0 <= alpha.min() <= alpha.max() <= 1
    assert overlap(alpha, truth) > 0.95
    assert not alpha[:, round(0.6 * shape[1]) :].any()


def test_the_best_mask_is_not_the_one_predicted_best(pairs):
    """The decoder offers all, the person, half of them, and a leak; it thinks best of the leak, worst of the person."""
    image, truth, roi, body = scene(150, 260)
    sam = provider("sam", pairs["sam"], None)
    seen: list[np.ndarray] = []
    decode = sam._decode
    sam._decode = lambda *given: seen.append(decode(*given)) or seen[-1]
    alpha = sam(image, roi, body)
    _, quality = seen[0]
    np.testing.assert_allclose(quality, [0.9, 0.8, 0.95, 0.99])
    assert overlap(alpha, truth) > 0.95


def test_alpha_is_the_logistic_function_of_enlarged_logits():
    logits = torch.randn(1, 1, 6, 9, generator=torch.Generator().manual_seed(0))
    logits[..., 3, 4] = 5
    point, box = np.array([[18.0, 14.0]]), np.array([[0, 0], [36, 24]])
    alpha = _chosen(logits[0].numpy(), np.ones(1), point, box, (24, 36))
    large = torch.nn.functional.interpolate(logits, (24, 36), mode="bilinear", align_corners=False)
    np.testing.assert_allclose(alpha, large[0, 0].sigmoid(), atol=1e-5)


def test_nothing_to_prompt_with_or_nothing_that_agrees(pairs):
    image, _, roi, body = scene(150, 260)
    sam = provider("sam", pairs["sam"])
    assert not sam(image, roi, body * (1, 1, 0.5)).any()
    assert not sam(image, Roi(0.0, 0.0, 0.0, 0.0), body).any()
    assert not sam(image, roi, body + np.array([600, 0, 0])).any()
    few = body * (1, 1, 0)
    few[:2, 2] = 0.9  # the decoder finds nothing for so few points
    assert not sam(image, roi, few).any()


def test_tensors_of_a_picture():
    image = np.full((60, 90, 3), (200, 100, 50), np.uint8)
    normalised = (np.array([200, 100, 50]) - (123.675, 116.28, 103.53)) / (58.395, 57.12, 57.375)
    canvas = padded(image, 1024)
    assert canvas.tensor.shape == (1, 3, 1024, 1024)
    assert canvas.size == canvas.covered == (683, 1024)  # round(60 * 1024 / 90)
    np.testing.assert_allclose(canvas.tensor[0, :, 682, 1023], normalised, atol=1e-5)
    assert not canvas.tensor[0, :, 683:].any()
    canvas = stretched(image, 1024)
    assert canvas.size == canvas.covered == (1024, 1024)
    np.testing.assert_allclose(canvas.tensor[0, :, 1023, 1023], normalised, atol=1e-5)
    canvas = with_own_preprocessing(image, (None, None, 3))
    assert canvas.tensor.shape == (683, 1024, 3)
    np.testing.assert_array_equal(canvas.tensor[682, 1023], (200, 100, 50))
    canvas = with_own_preprocessing(image.transpose(1, 0, 2), (684, 1024, 3))
    assert (canvas.tensor.shape, canvas.size, canvas.covered) == ((684, 1024, 3), (684, 1024), (684, 456))
    assert not canvas.tensor[:, 456:].any()


@pytest.mark.parametrize(
    ("encoder", "decoder"), [("sam", "sam2"), ("sam2", "sam"), ("sam2", "sam2_runtime"), ("sam_own", "sam2_runtime")]
)
def test_files_of_two_families_are_no_pair(pairs, encoder, decoder):
    files = {"encoder": pairs[encoder]["encoder"], "decoder": pairs[decoder]["decoder"]}
    with pytest.raises(ModelFileError, match="belong together") as error:
        provider("sam", files)
    assert "SAM 2 of samexporter: an encoder from a picture to image_embed" in error.value.expected
    assert "takes image" in error.value.got or "takes input_image" in error.value.got
    assert "point_coords [" in error.value.got


def test_files_in_the_wrong_order_or_of_another_kind(pairs, tmp_path):
    swapped = dict(zip(("encoder", "decoder"), reversed(pairs["sam"].values()), strict=True))
    with pytest.raises(ModelFileError, match="belong together"):
        provider("sam", swapped)
    shallow = export(torch.nn.AvgPool2d(16), tmp_path / "e.onnx", {"x": torch.rand(1, 3, 1024, 1024)}, ["y"])
    with pytest.raises(ModelFileError, match="belong together") as error:
        provider("sam", pairs["sam"] | {"encoder": shallow})
    assert "x [1, 3, 1024, 1024] (float)" in error.value.got


def test_missing_files_and_settings(pairs, tmp_path):
    with pytest.raises(ConfigError, match=r"masks\.decoder is not set"):
        provider("sam", {"encoder": pairs["sam"]["encoder"]})
    with pytest.raises(ModelFileError, match="missing"):
        provider("sam", pairs["sam"] | {"decoder": tmp_path / "none.onnx"})
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(pairs["sam"]["decoder"].read_bytes()[:300])
    with pytest.raises(ModelFileError):
        provider("sam", pairs["sam"] | {"decoder": broken})
    with pytest.raises(ConfigError, match="unknown prompt"):
        provider("sam", pairs["sam"], prompt=1)


def test_a_decoder_that_answers_nan(pairs, tmp_path):
    class Nan(exports.SamDecoder):
        def forward(
            self, image_embeddings, point_coords, point_labels, mask_input, has_mask_input, orig_im_size
        ):  # fmt: skip
            given = image_embeddings, point_coords, point_labels, mask_input, has_mask_input, orig_im_size
            masks, quality, low = super().forward(*given)
            return masks / (0 * quality[0, 0]), quality, low

    decoder = exports.sam_decoder(Nan(), tmp_path / "nan.onnx")
    image, _, roi, body = scene(150, 260)
    with pytest.raises(ModelFileError, match="NaN or infinity in masks"):
        provider("sam", pairs["sam"] | {"decoder": decoder})(image, roi, body)
