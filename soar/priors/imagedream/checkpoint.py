"""The released checkpoint: read safely, part by part, every key accounted for."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from soar.errors import ModelFileError
from soar.priors.imagedream.schedule import alphas_cumprod

UNET, VAE, CLIP = "model.diffusion_model.", "vae_model.", "clip_model.model."
"""Beginnings of the keys of the parts."""

_SCHEDULE = frozenset(
    (
        "betas", "alphas_cumprod", "alphas_cumprod_prev", "sqrt_alphas_cumprod", "sqrt_one_minus_alphas_cumprod",
        "log_one_minus_alphas_cumprod", "sqrt_recip_alphas_cumprod", "sqrt_recipm1_alphas_cumprod",
        "posterior_variance", "posterior_log_variance_clipped", "posterior_mean_coef1", "posterior_mean_coef2",
    )
)  # fmt: skip
_CURE = "bring sd-v2.1-base-4view-ipmv.pt or sd-v2.1-base-4view-ipmv-local.pt as published (docs/priors.md)"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A tensor of a checkpoint and what it becomes.

    Attributes:
        shape: in the checkpoint.
        targets: the module's keys that take equal shares of it along the first axis.
    """

    shape: tuple[int, ...]
    targets: tuple[str, ...]


Layout = Mapping[str, Entry]
"""Entries by key of the checkpoint, without the part's prefix."""


def plain(module: nn.Module) -> Layout:
    """The layout of a module whose own keys are those of the checkpoint."""
    return {key: Entry(tuple(value.shape), (key,)) for key, value in module.state_dict().items()}


class Checkpoint:
    """A file of weights; tensors are read from disk when they are used.

    Args:
        path: a ``.pt`` of named tensors.

    Raises:
        ModelFileError: it is missing, damaged, holds anything but tensors, or has a noise schedule of its own.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise ModelFileError(f"{path} is missing", cure=_CURE)
        try:
            tensors = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        except (RuntimeError, pickle.UnpicklingError, EOFError, ValueError) as error:
            raise ModelFileError(f"{path} cannot be read safely: {str(error)[:300]}", cure=_CURE) from error
        if not isinstance(tensors, dict) or not all(isinstance(value, Tensor) for value in tensors.values()):
            raise ModelFileError(f"{path} holds something else", expected="tensors by name", cure=_CURE)
        self.tensors: dict[str, Tensor] = tensors
        strange = [key for key in tensors if key not in _SCHEDULE and not key.startswith((UNET, VAE, CLIP))]
        self._refuse("keys that no part has", strange)
        schedule, ours = tensors.get("alphas_cumprod"), alphas_cumprod()
        if schedule is not None and not (
            schedule.shape == ours.shape and torch.allclose(schedule.double(), ours, atol=1e-6)
        ):
            raise ModelFileError(f"{path} was trained with another noise schedule", cure=_CURE)

    def load(
        self,
        prefix: str,
        module: nn.Module,
        layout: Layout,
        spare: Callable[[str], bool],
        device: torch.device,
        dtype: torch.dtype,
    ) -> None:
        """Fill a module made on the device ``meta``, and freeze it.

        Args:
            prefix: of the part's keys.
            module: all its parameters are replaced.
            layout: where they come from.
            spare: says of a key, without prefix, that this module needs none.
            device, dtype: of the weights.

        Raises:
            ModelFileError: a key is missing, unexpected, or of another shape.
        """
        found = {key.removeprefix(prefix): value for key, value in self.tensors.items() if key.startswith(prefix)}
        self._refuse(f"keys missing below {prefix}", layout.keys() - found.keys())
        self._refuse(f"unexpected keys below {prefix}", [k for k in found.keys() - layout.keys() if not spare(k)])
        wrong = [
            f"{key} {tuple(found[key].shape)} for {entry.shape}"
            for key, entry in layout.items()
            if tuple(found[key].shape) != entry.shape
        ]
        self._refuse(f"other shapes below {prefix}", wrong)
        expected = module.state_dict()
        state = {}
        for key, entry in layout.items():
            for target, part in zip(entry.targets, found[key].chunk(len(entry.targets)), strict=True):
                # A copy even where nothing is converted: a mapped file must not be torn under a running network.
                state[target] = part.reshape(expected[target].shape).to(device, dtype, copy=True)
        module.load_state_dict(state, assign=True)
        module.requires_grad_(False).eval()

    def _refuse(self, what: str, keys: Iterable[str]) -> None:
        listed = sorted(keys)
        if listed:
            shown = ", ".join(listed[:5]) + (f" and {len(listed) - 5} more" if len(listed) > 5 else "")
            raise ModelFileError(f"{self.path} has {what}", got=shown, cure=_CURE)
