"""A small multi-view prior with weights that do something, and inputs for it, for tests."""

import numpy as np
import torch

from soar.networks.prior import PriorNetwork, PriorNetworkSettings
from soar.networks.prior_inputs import ALPHA_KNOWN, CARRIED, CONDITIONED, DOMAIN, VIEWS

SETTINGS = PriorNetworkSettings(widths=(8, 16, 16), depths=(1, 1, 1), embedding=16, head=8, pointer=4)
SIZE = 16
NAMES = ("noisy", "time", "image", "geometry", "alpha", "carried", "flags")


def network(seed: int = 0) -> PriorNetwork:
    """Random weights, also where training would start from zero."""
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(seed)
        made = PriorNetwork(SETTINGS)
        for parameter in made.parameters():
            if parameter.ndim > 1:
                parameter.normal_(0, 0.7 / parameter[0].numel() ** 0.5)
    return made.eval()


def inputs(count: int = 2, seed: int = 0, conditioned: float = 1.0, size: int = SIZE) -> dict[str, torch.Tensor]:
    """Noise in place of pictures; half of the pixels show the body; domains and kinds of alpha alternate."""
    rng = np.random.default_rng(seed)
    views = (count, VIEWS)
    geometry = rng.uniform(-1, 1, (count, VIEWS + 1, 7, size, size))
    geometry[:, :, 6] = rng.uniform(size=geometry[:, :, 6].shape) < 0.5
    geometry *= geometry[:, :, 6:]
    flags = np.zeros((count, 3))
    flags[:, CONDITIONED] = conditioned
    flags[::2, DOMAIN] = flags[1::2, ALPHA_KNOWN] = 1
    arrays = (
        rng.normal(size=(*views, 3, size, size)),
        rng.uniform(0.1, 0.9, count),
        rng.uniform(-1, 1, (count, 3, size, size)),
        geometry,
        rng.uniform(size=(count, VIEWS + 1, 1, size, size)),
        rng.uniform(-1, 1, (*views, CARRIED, size, size)),
        flags,
    )
    return {name: torch.from_numpy(array).float() for name, array in zip(NAMES, arrays, strict=True)}
