"""Where tensors are computed with."""

from __future__ import annotations

import torch

from soar.errors import ConfigError


def resolve_device(name: str, key: str) -> torch.device:
    """The device that ``auto``, ``cpu``, ``cuda`` ... stands for.

    Args:
        name: what the configuration says.
        key: where it says so, for messages.

    Raises:
        ConfigError: torch knows no such device, or this machine has none.
    """
    if name == "auto":
        return torch.accelerator.current_accelerator() or torch.device("cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"{key}: no device {name}", got=str(error).splitlines()[0], cure="use auto or cpu") from error
    return device
