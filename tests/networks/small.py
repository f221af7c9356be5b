"""A small normal network with weights that do something, for tests."""

import torch

from soar.networks.normals import NormalNetwork, NormalNetworkSettings

SETTINGS = NormalNetworkSettings((8, 16), (1, 1))


def network(seed: int = 0) -> NormalNetwork:
    """Random weights, also where training would start from zero."""
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(seed)
        made = NormalNetwork(SETTINGS)
        for parameter in made.parameters():
            if parameter.ndim > 1:
                parameter.normal_(0, 0.3 / parameter[0].numel() ** 0.5)
    return made.eval()
