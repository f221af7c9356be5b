"""From the checkpoint of ICON's or ECON's normal networks to the two ONNX files that the provider ``icon`` opens.

The generator is that of pix2pixHD (Wang et al., High-Resolution Image Synthesis and Semantic Manipulation with
Conditional GANs, CVPR 2018) with four halvings, nine residual blocks and normalisation of each picture by itself.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from soar.errors import ModelFileError
from soar.models.onnx import Shape, Signature
from soar.perception.icon import SIGNATURES
from soar.priors.imagedream.export import write

WIDTH = 64
"""Channels at full resolution."""

_HALVINGS, _BLOCKS = 4, 9
_CURE = "bring normal.ckpt of ICON or ECON as published (docs/normals.md)"


class Block(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # The names of its parts, and their places in the list, are the checkpoint's.
        self.conv_block = nn.Sequential(
            nn.ReflectionPad2d(1), nn.Conv2d(channels, channels, 3), nn.InstanceNorm2d(channels), nn.ReLU(),
            nn.ReflectionPad2d(1), nn.Conv2d(channels, channels, 3), nn.InstanceNorm2d(channels),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv_block(x)


class Generator(nn.Module):
    """Normals in [-1, 1], not of unit length, from a picture and the body's normals, each (N, 3, H, W).

    Args:
        width: channels at full resolution; others than :data:`WIDTH` only in tests.
    """

    def __init__(self, width: int = WIDTH) -> None:
        super().__init__()
        widths = [width * 2**i for i in range(_HALVINGS + 1)]
        layers = [nn.ReflectionPad2d(3), nn.Conv2d(6, width, 7), nn.InstanceNorm2d(width), nn.ReLU()]
        for near, far in itertools.pairwise(widths):
            layers += [nn.Conv2d(near, far, 3, stride=2, padding=1), nn.InstanceNorm2d(far), nn.ReLU()]
        layers += [Block(widths[-1]) for _ in range(_BLOCKS)]
        for far, near in zip(widths[:0:-1], widths[-2::-1], strict=True):
            grown = nn.ConvTranspose2d(far, near, 3, stride=2, padding=1, output_padding=1)
            layers += [grown, nn.InstanceNorm2d(near), nn.ReLU()]
        self.model = nn.Sequential(*layers, nn.ReflectionPad2d(3), nn.Conv2d(width, 3, 7), nn.Tanh())

    def forward(self, image: Tensor, body: Tensor) -> Tensor:
        return self.model(torch.cat([image, body], 1))


def export_normals(checkpoint: Path, folder: Path, threads: int, width: int = WIDTH) -> None:
    """Write ``netF.onnx`` and ``netB.onnx``, each with its weights in a file beside it, compared with torch on noise.

    Args:
        checkpoint: of PyTorch Lightning, with ``netG.netF`` and ``netG.netB`` in its ``state_dict``.
        folder: for the files; about 1.5 GB.
        threads: of the comparisons.
        width: see :class:`Generator`.

    Raises:
        ModelFileError: the checkpoint is not the right one, or a file does not compute what its network does.
        StorageError: the disk is full or not writable.
    """
    weights = read_checkpoint(checkpoint)
    torch.set_num_threads(threads)
    for name, signature in SIGNATURES.items():
        network = _empty(width)
        found = matched(checkpoint, name, weights, width)
        network.load_state_dict({key: value.float() for key, value in found.items()}, assign=True)
        any_count = Signature(_any_count(signature.inputs), _any_count(signature.outputs))
        write(network, any_count, 1, folder / f"{name}.onnx", threads)


def _any_count(shapes: Mapping[str, Shape]) -> dict[str, Shape]:
    return {name: (None, *shape[1:]) for name, shape in shapes.items()}


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The ``state_dict`` of a checkpoint, read from disk as it is used.

    Raises:
        ModelFileError: the file is missing, damaged, holds something else, or cannot be read without running it.
    """
    if not path.is_file():
        raise ModelFileError(f"{path} is missing", cure=_CURE)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError, ValueError, KeyError, OSError) as error:
        raise ModelFileError(
            f"{path} cannot be read safely: {str(error)[:300]}",
            cure=f"{_CURE}; one that holds more than weights must be reduced to its state_dict where it was made",
        ) from error
    state = content.get("state_dict") if isinstance(content, dict) else None
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise ModelFileError(f"{path} holds something else", expected="state_dict, a dict of tensors", cure=_CURE)
    return state


def _empty(width: int) -> Generator:
    with torch.device("meta"):
        return Generator(width).requires_grad_(False).eval()


def matched(path: Path, name: str, weights: Mapping[str, Tensor], width: int = WIDTH) -> dict[str, Tensor]:
    """The weights of the generator ``netF`` or ``netB``, by the generator's own keys.

    Raises:
        ModelFileError: one is missing, too many, or of another shape.
    """
    prefix, expected = f"netG.{name}.", _empty(width).state_dict()
    found = {key.removeprefix(prefix): value for key, value in weights.items() if key.startswith(prefix)}
    wrong = {
        "lacks": expected.keys() - found.keys(),
        "has besides": found.keys() - expected.keys(),
        "has in another shape": {k for k in expected.keys() & found.keys() if expected[k].shape != found[k].shape},
    }
    for what, keys in wrong.items():
        if keys:
            shown = (f"{k} {tuple(found[k].shape) if k in found else ''}".strip() for k in sorted(keys)[:5])
            raise ModelFileError(
                f"{path} {what} {len(keys)} of the weights of {prefix[:-1]}",
                expected=f"{len(expected)} weights of a generator of {width} channels, such as {prefix}model.1.weight",
                got=", ".join(shown), cure=_CURE,
            )  # fmt: skip
    return found
