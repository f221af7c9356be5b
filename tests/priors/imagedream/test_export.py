"""Exported files compute what their networks compute, for any number of objects; the provider `onnx` runs on them."""

import dataclasses

import numpy as np
import onnx
import pytest
import torch

from soar.errors import ConfigError, ModelFileError
from soar.models.onnx import session
from soar.priors.imagedream import export as exporter
from soar.priors.imagedream.export import difference, export_networks, write
from soar.priors.imagedream.onnx import OnnxNetworks, from_export, signatures
from soar.priors.imagedream.prior import ImageDream
from tests.priors.imagedream.small import OPTIONS, SHAPE, SIZE, SmallNetworks, SmallTokens, condition, generator, views


def contract(mode):
    return signatures(mode, SIZE // 8, SHAPE.context)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Small networks of the pixel mode, and the folder with their files."""
    folder, made = tmp_path_factory.mktemp("pixel"), SmallNetworks("pixel", torch.float32)
    export_networks(made, contract("pixel"), folder, 1)
    return made, folder


def test_shapes_of_the_contract():
    pixel, local = signatures("pixel"), signatures("local")
    assert pixel["unet"].inputs == {
        "x": (None, 4, 32, 32), "timesteps": (None,), "context": (None, 77, 1024), "camera": (None, 16),
        "ip": (None, 257, 1280), "ip_img": (None, 4, 32, 32),
    }  # fmt: skip
    assert list(local["unet"].inputs) == ["x", "timesteps", "context", "camera", "ip"]
    assert pixel["text_encoder"].outputs == {"hidden": (None, 77, 1024)}
    assert pixel["image_encoder"].inputs == {"pixel_values": (None, 3, 224, 224)}
    assert pixel["vae_encoder"].outputs == {"moments": (None, 8, 32, 32)}
    assert pixel["vae_decoder"].outputs == {"image": (None, 3, 256, 256)}


def test_weights_lie_beside_the_graph_and_nowhere_else(exported):
    made, folder = exported
    graph = onnx.load(folder / "unet.onnx", load_external_data=False)
    stored = {tensor.name: tensor for tensor in graph.graph.initializer}
    weights = sum(p.numel() for p in made.unet.parameters())
    assert sum(int(np.prod(tensor.dims)) for tensor in stored.values()) == weights
    assert all(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in stored.values())
    assert (folder / "unet.onnx").stat().st_size < 0.2 * (folder / "unet.onnx.data").stat().st_size
    assert [(entry.domain, entry.version) for entry in graph.opset_import] == [("", 17)]


def test_comparison_sees_another_network(exported):
    made, folder = exported
    other = SmallNetworks("pixel", torch.float32).unet
    with torch.no_grad():
        other.out[2].weight.mul_(1.01)
    assert difference(other, contract("pixel")["unet"], made.frames, folder / "unet.onnx", 1) > 1e-3


def test_provider_gives_what_torch_gives(exported):
    _, folder = exported
    options = dataclasses.replace(OPTIONS, mode="pixel", form="image")
    shown = dataclasses.replace(views(), pictures=views().pictures.detach().float(), alpha=views().alpha.float())
    found = []
    for networks in (SmallNetworks("pixel"), OnnxNetworks(folder, "pixel", 1, contract("pixel"))):
        prior = ImageDream(options, networks, SmallTokens(), torch.device("cpu"), SIZE)
        (prompt,) = prior.prepare([condition()])
        pictures = shown.pictures.clone().requires_grad_()
        loss = prior.loss(prompt, dataclasses.replace(shown, pictures=pictures), 0.4, generator())
        found.append((loss.float(), torch.autograd.grad(loss, pictures)[0]))
    (loss, gradient), (expected, expected_gradient) = found
    torch.testing.assert_close(loss, expected, rtol=1e-4, atol=0)
    # The small decoder magnifies the rounding of single precision at a few pixels.
    assert (gradient - expected_gradient).abs().max() < 1e-2 * expected_gradient.abs().max()
    assert (gradient - expected_gradient).std() < 1e-3 * expected_gradient.std()


def test_local_mode(tmp_path, exported):
    """Four views and no latent of the picture; a file of the other mode is refused."""
    made, path = SmallNetworks("local", torch.float32), tmp_path / "unet.onnx"
    assert write(made.unet, contract("local")["unet"], made.frames, path, 1) < 1e-4
    with pytest.raises(ModelFileError, match="other inputs"):
        session(path, 1, contract("pixel")["unet"])
    with pytest.raises(ModelFileError, match="other inputs"):
        session(exported[1] / "unet.onnx", 1, contract("local")["unet"])


def test_tokens_must_be_whole_numbers(exported):
    floats = dataclasses.replace(contract("pixel")["text_encoder"], integers=frozenset())
    with pytest.raises(ModelFileError, match="other inputs") as caught:
        session(exported[1] / "text_encoder.onnx", 1, floats)
    assert "input_ids (free, 77) float32" in caught.value.expected


def test_a_file_that_differs_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(exporter, "TOLERANCE", -1.0)
    made = SmallNetworks("local", torch.float32)
    with pytest.raises(ModelFileError, match="would not compute"):
        write(made.words, contract("local")["text_encoder"], 1, tmp_path / "text_encoder.onnx", 1)
    assert not (tmp_path / "text_encoder.onnx").exists()


def test_no_gradient_through_files(tmp_path):
    with pytest.raises(ConfigError, match="no gradient"):
        from_export(dataclasses.replace(OPTIONS, provider="onnx", form="latent"), tmp_path, 1)


def test_an_empty_folder_says_what_is_missing(tmp_path):
    with pytest.raises(ModelFileError, match=r"tokenizer\.json is missing"):
        from_export(dataclasses.replace(OPTIONS, provider="onnx", form="image", source=str(tmp_path)), tmp_path, 1)
    networks = OnnxNetworks(tmp_path, "pixel", 1)
    with pytest.raises(ModelFileError, match=r"unet\.onnx is missing"):
        networks.noise(*[torch.zeros(1)] * 6)
