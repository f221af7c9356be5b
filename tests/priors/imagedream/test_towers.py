"""Autoencoder and towers take the released keys and compute what the official code and OpenCLIP compute."""

import pytest
import torch

pytest.importorskip("diffusers", reason="the optional extra imagedream is not installed")
pytest.importorskip("transformers", reason="the optional extra imagedream is not installed")

from soar.models.onnx import Signature
from soar.priors.imagedream.checkpoint import CLIP, VAE, Checkpoint
from soar.priors.imagedream.export import Method, write
from soar.priors.imagedream.networks import planned
from soar.priors.imagedream.schedule import alphas_cumprod
from soar.priors.imagedream.towers import Autoencoder, ImageTower, TextTower
from tests.priors.imagedream.small import digest, wave, weights

WIDTH, HEADS, BLOCKS, VOCABULARY = 32, 2, 2, 60
CPU = torch.device("cpu")


def clip_shapes(width, visual, blocks, visual_blocks, vocabulary, patches, patch):
    """Keys and shapes of an OpenCLIP model, as OpenCLIP names them."""

    def block(prefix, size):
        inner = {"ln_1": (size,), "ln_2": (size,), "attn.out_proj": (size, size), "mlp.c_fc": (4 * size, size)}
        inner["mlp.c_proj"] = (size, 4 * size)
        shapes = {f"{prefix}.{name}.weight": shape for name, shape in inner.items()}
        shapes |= {f"{prefix}.{name}.bias": shape[:1] for name, shape in inner.items()}
        return shapes | {f"{prefix}.attn.in_proj_weight": (3 * size, size), f"{prefix}.attn.in_proj_bias": (3 * size,)}

    shapes = {
        "token_embedding.weight": (vocabulary, width), "positional_embedding": (77, width),
        "ln_final.weight": (width,), "ln_final.bias": (width,), "text_projection": (width, width), "logit_scale": (),
        "visual.conv1.weight": (visual, 3, patch, patch), "visual.class_embedding": (visual,),
        "visual.positional_embedding": (patches + 1, visual), "visual.proj": (visual, width),
    }  # fmt: skip
    shapes |= {f"visual.ln_{p}.{k}": (visual,) for p in ("pre", "post") for k in ("weight", "bias")}
    for number in range(blocks + 1):
        shapes |= block(f"transformer.resblocks.{number}", width)
    for number in range(visual_blocks + 1):
        shapes |= block(f"visual.transformer.resblocks.{number}", visual)
    return shapes


def shapes(layout):
    return {key: entry.shape for key, entry in layout.items()}


def loaded(make, prefix, state, tmp_path):
    path = tmp_path / "checkpoint.pt"
    torch.save({f"{prefix}{k}": v for k, v in state.items()} | {"alphas_cumprod": alphas_cumprod().float()}, path)
    made = planned(make)
    spare = getattr(made, "spare", lambda key: False)
    Checkpoint(path).load(prefix, made, made.layout(), spare, CPU, torch.float32)
    return made


def sampled(x):
    """Twelve values, evenly spread."""
    flat = x.flatten()
    return flat[torch.linspace(0, len(flat) - 1, 12).long()]


def test_autoencoder_keys_and_shapes_are_the_released_ones():
    layout = planned(Autoencoder).layout()
    assert len(layout) == 248
    assert digest(shapes(layout)) == "50f3b11a29b7157160b560d7d5f6efb72f882aec8c53fda4aeb592ed800e4e5f"


def test_tower_keys_and_shapes_are_those_of_openclip():
    released = clip_shapes(1024, 1280, 23, 31, 49408, 256, 14)
    assert len(released) == 686
    assert digest(released) == "e8c4c7fb33610e2fabd57424351e6a9095993cd49a0c27633e995eed05ac83c6"
    text, image = planned(TextTower), planned(ImageTower)
    both = shapes(text.layout()) | shapes(image.layout())
    assert len(both) == len(text.layout()) + len(image.layout()) == 280 + 379
    assert {key: released[key] for key in both} == both
    assert all(text.spare(key) and image.spare(key) for key in released.keys() - both.keys())
    assert not any(text.spare(key) for key in text.layout())
    assert not any(image.spare(key) for key in image.layout())


def test_towers_compute_what_openclip_computes(tmp_path):
    """Golden numbers of OpenCLIP 3.3 with the same weights; the last block of each tower is left out."""
    state = weights(clip_shapes(WIDTH, WIDTH, BLOCKS, BLOCKS, VOCABULARY, 4, 14))
    start, end = VOCABULARY - 2, VOCABULARY - 1
    ids = torch.zeros(2, 77, dtype=torch.int64)
    for row, words in zip(ids, ([5, 17], range(10, 50)), strict=True):
        row[: len(words) + 2] = torch.tensor([start, *words, end])
    text = loaded(lambda: TextTower(WIDTH, HEADS, BLOCKS, VOCABULARY), CLIP, state, tmp_path)(ids)
    assert text.shape == (2, 77, WIDTH)
    expected = [-0.79351, 1.11318, 1.1771, -0.01187, 1.21347, 1.05163, -1.76347, 0.98567, -0.8224, 0.93988, 1.21129,
                -0.28397]  # fmt: skip
    torch.testing.assert_close(sampled(text), torch.tensor(expected), atol=1e-4, rtol=0)
    image = loaded(lambda: ImageTower(WIDTH, HEADS, BLOCKS, 28, 14), CLIP, state, tmp_path)(
        wave(0.113, 1, 2, 3, 28, 28)
    )
    assert image.shape == (2, 5, WIDTH)
    expected = [-1.97381, 0.35666, 4.84181, -0.04292, -3.23541, 2.49768, 0.61051, -2.05681, 4.97962, -5.55985, -0.68343,
                -1.50432]  # fmt: skip
    torch.testing.assert_close(sampled(image), torch.tensor(expected), atol=1e-4, rtol=0)


def small_autoencoder(tmp_path):
    state = weights(shapes(planned(lambda: Autoencoder((32, 64))).layout()))
    return loaded(lambda: Autoencoder((32, 64)), VAE, state, tmp_path)


def test_autoencoder_computes_what_the_official_code_computes(tmp_path):
    """Golden numbers of ImageDream's encoder and decoder with the same weights."""
    made = small_autoencoder(tmp_path)
    moments, picture = made.encode(wave(0.113, 1, 2, 3, 16, 16)), made.decode(wave(0.231, 2, 2, 4, 8, 8))
    assert moments.shape == (2, 8, 8, 8)
    assert picture.shape == (2, 3, 16, 16)
    expected = [-0.07162, -0.34278, -0.22818, -0.10411, 0.11761, 0.40901, 0.12798, 0.06776, 0.04185, -0.31224, -0.48696,
                0.3899]  # fmt: skip
    torch.testing.assert_close(sampled(moments), torch.tensor(expected), atol=1e-4, rtol=0)
    expected = [0.00691, -0.22378, -0.01034, -0.28426, -0.1919, 0.2519, -0.19442, 0.04271, -0.23264, -0.25382, -0.18818,
                -0.05405]  # fmt: skip
    torch.testing.assert_close(sampled(picture), torch.tensor(expected), atol=1e-4, rtol=0)


def test_encoder_has_a_gradient(tmp_path):
    picture = wave(0.113, 1, 1, 3, 16, 16).requires_grad_()
    small_autoencoder(tmp_path).encode(picture).square().sum().backward()
    assert (picture.grad != 0).float().mean() > 0.9


def test_parts_can_be_exported(tmp_path):
    """Text and pictures in any number."""
    state = weights(clip_shapes(WIDTH, WIDTH, BLOCKS, BLOCKS, 1000, 4, 14))
    text = loaded(lambda: TextTower(WIDTH, HEADS, BLOCKS, 1000), CLIP, state, tmp_path)
    image = loaded(lambda: ImageTower(WIDTH, HEADS, BLOCKS, 28, 14), CLIP, state, tmp_path)
    autoencoder = small_autoencoder(tmp_path)
    parts = {
        "text": (text, Signature({"ids": (None, 77)}, {"hidden": (None, 77, WIDTH)}, frozenset({"ids"}))),
        "image": (image, Signature({"pixels": (None, 3, 28, 28)}, {"hidden": (None, 5, WIDTH)})),
        "encoder": (Method(autoencoder, "encode"), Signature({"x": (None, 3, 16, 16)}, {"y": (None, 8, 8, 8)})),
        "decoder": (Method(autoencoder, "decode"), Signature({"x": (None, 4, 8, 8)}, {"y": (None, 3, 16, 16)})),
    }
    for name, (network, signature) in parts.items():
        assert write(network, signature, 1, tmp_path / f"{name}.onnx", 1) < 1e-4
