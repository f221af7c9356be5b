import pytest
import torch

from soar.devices import resolve_device
from soar.errors import ConfigError


def test_devices():
    assert resolve_device("cpu", "here").type == "cpu"
    assert resolve_device("auto", "here") == (torch.accelerator.current_accelerator() or torch.device("cpu"))
    with pytest.raises(ConfigError, match="here: no device abacus"):
        resolve_device("abacus", "here")
