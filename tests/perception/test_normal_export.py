"""The export of ICON's normal networks, on a narrow generator of the published layout with random weights."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from soar.errors import ModelFileError
from soar.models.onnx import session
from soar.perception.icon import SIGNATURES
from soar.perception.icon_export import Generator, export_normals
from tests.conftest import conf
from tests.perception import normal_scenes as scenes

WIDTH = 2


def shapes(width: int = WIDTH) -> dict[str, tuple[int, ...]]:
    """Keys and shapes of a checkpoint's generators, as published, written out by hand."""
    kernels = {"model.1": (width, 6, 7, 7), "model.38": (3, width, 7, 7)}
    for i in range(4):  # halvings, and doublings, whose kernels are (in, out, height, width)
        near, far = width * 2**i, width * 2 ** (i + 1)
        kernels[f"model.{4 + 3 * i}"] = (far, near, 3, 3)
        kernels[f"model.{34 - 3 * i}"] = (far, near, 3, 3)
    for i in range(9):
        for part in (1, 5):
            kernels[f"model.{16 + i}.conv_block.{part}"] = (16 * width, 16 * width, 3, 3)
    found: dict[str, tuple[int, ...]] = {}
    for name in ("netF", "netB"):
        for key, shape in kernels.items():
            found[f"netG.{name}.{key}.weight"] = shape
            found[f"netG.{name}.{key}.bias"] = (shape[1 if 25 <= int(key.split(".")[1]) <= 34 else 0],)
    return found


def state(width: int = WIDTH) -> dict[str, torch.Tensor]:
    """Random weights of such shapes, as large as keeps what passes through them."""
    generator = torch.Generator().manual_seed(0)
    return {
        key: torch.randn(shape, generator=generator) / math.prod(shape[1:2]) ** 0.5
        for key, shape in shapes(width).items()
    }


def checkpoint(path: Path, tensors: dict[str, torch.Tensor]) -> Path:
    torch.save({"state_dict": tensors, "epoch": 3}, path)
    return path


def by_hand(tensors: dict[str, torch.Tensor], prefix: str, x: torch.Tensor) -> torch.Tensor:
    """What the published network computes, step by step, from its weights."""

    def normed(x: torch.Tensor) -> torch.Tensor:
        mean, variance = x.mean((2, 3), keepdim=True), x.var((2, 3), keepdim=True, unbiased=False)
        return (x - mean) / (variance + 1e-5).sqrt()

    def weights(key: str) -> tuple[torch.Tensor, torch.Tensor]:
        return tensors[f"{prefix}.{key}.weight"], tensors[f"{prefix}.{key}.bias"]

    x = normed(F.conv2d(F.pad(x, (3,) * 4, "reflect"), *weights("model.1"))).relu()
    for i in (4, 7, 10, 13):
        x = normed(F.conv2d(x, *weights(f"model.{i}"), stride=2, padding=1)).relu()
    for i in range(16, 25):
        inner = normed(F.conv2d(F.pad(x, (1,) * 4, "reflect"), *weights(f"model.{i}.conv_block.1"))).relu()
        x = x + normed(F.conv2d(F.pad(inner, (1,) * 4, "reflect"), *weights(f"model.{i}.conv_block.5")))
    for i in (25, 28, 31, 34):
        x = normed(F.conv_transpose2d(x, *weights(f"model.{i}"), stride=2, padding=1, output_padding=1)).relu()
    return F.conv2d(F.pad(x, (3,) * 4, "reflect"), *weights("model.38")).tanh()


def test_the_files_compute_what_the_checkpoint_does(tmp_path: Path) -> None:
    tensors = state() | {"netG.vgg.layer.weight": torch.zeros(1)}  # of the training, not of the generators
    export_normals(checkpoint(tmp_path / "normal.ckpt", tensors), tmp_path / "icon", 1, WIDTH)
    generator = np.random.default_rng(1)
    image, body = (generator.uniform(-1, 1, (1, 3, 512, 512)).astype(np.float32) for _ in range(2))
    for name, signature in SIGNATURES.items():
        opened = session(tmp_path / "icon" / f"{name}.onnx", 1, signature)
        (got,) = opened.run(None, {"image": image, f"T_normal_{name[-1]}": body})
        expected = by_hand(tensors, f"netG.{name}", torch.from_numpy(np.concatenate([image, body], 1))).numpy()
        assert expected.std() > 0.1
        assert np.abs(got - expected).max() < 2e-3
    crop = scenes.crop()
    from soar.perception.normals import normal_provider

    made = normal_provider(
        conf("normals", "icon") | {"device": "cpu"}, scenes.context([crop], {"network": tmp_path / "icon"})
    )
    inside = crop.alpha > 127
    for found in made.maps(crop):
        np.testing.assert_allclose(np.linalg.norm(found[inside], axis=-1), 1, atol=1e-5)


def test_the_released_size() -> None:
    with torch.device("meta"):
        parameters = sum(value.numel() for value in Generator().parameters())
    assert parameters == 182_452_675


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda t: t.pop("netG.netB.model.20.conv_block.5.bias"), r"lacks 1 (.*\n)*.*model\.20\.conv_block\.5\.bias"),
        (
            lambda t: t.update({"netG.netF.model.39.weight": torch.zeros(1)}),
            r"has besides 1 (.*\n)*.*model\.39\.weight",
        ),
        (
            lambda t: t.update({"netG.netF.model.1.weight": torch.zeros(2, 3, 7, 7)}),
            r"in another shape 1 (.*\n)*.*model\.1\.weight \(2, 3, 7, 7\)",
        ),
        (lambda t: t.clear(), r"lacks 56 "),
    ],
)
def test_other_weights_are_named(tmp_path: Path, change, match: str) -> None:
    tensors = state()
    change(tensors)
    with pytest.raises(ModelFileError, match=match):
        export_normals(checkpoint(tmp_path / "normal.ckpt", tensors), tmp_path / "icon", 1, WIDTH)


def test_a_generator_of_another_width_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="another shape"):
        export_normals(checkpoint(tmp_path / "normal.ckpt", state(3)), tmp_path / "icon", 1, WIDTH)


class Bomb:
    def __reduce__(self) -> tuple:
        return (Path.touch, (Path("exploded"),))


def test_files_that_are_no_checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("normal.ckpt")

    def refused(match: str) -> None:
        with pytest.raises(ModelFileError, match=match):
            export_normals(path, Path("icon"), 1, WIDTH)

    refused("is missing")
    torch.save({"state_dict": Bomb()}, path)
    refused("cannot be read safely")
    assert not Path("exploded").exists()
    for content in ({"weights": {}}, [1], {"state_dict": {"a": 1}}, {"state_dict": nn.Linear(1, 1).weight}):
        torch.save(content, path)
        refused("holds something else|cannot be read safely")
    checkpoint(path, state())
    path.write_bytes(path.read_bytes()[:5000])
    refused("cannot be read safely")
    path.write_bytes(b"")
    refused("cannot be read safely")
