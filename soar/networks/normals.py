"""The normal network: from a picture of a clothed person and the naked body's normals to the clothed normals."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor, nn

from soar.networks.blocks import UNet
from soar.networks.normal_inputs import INPUTS, OUTPUTS


@dataclasses.dataclass(frozen=True)
class NormalNetworkSettings:
    """Size of the network.

    Attributes:
        widths: channels at 1/2, 1/4, ... of the picture's resolution, multiples of 8.
        depths: residual blocks at each.
    """

    widths: tuple[int, ...]
    depths: tuple[int, ...]


class NormalNetwork(nn.Module):
    """Predicts what clothes, hair and misplaced limbs change of the body's normals, which it gives back untrained.

    The task is that of ICON's normal network (Xiu et al., 2022): a picture and the body's normals in, front and back
    normals out. Both sides come from one U-Net, as a residual on the body's normals.
    """

    def __init__(self, settings: NormalNetworkSettings) -> None:
        super().__init__()
        self.unet = UNet(sum(INPUTS.values()), sum(OUTPUTS.values()), settings.widths, settings.depths)

    @property
    def stride(self) -> int:
        """Height and width must be multiples of this."""
        return self.unet.stride

    def forward(
        self, image: Tensor, mask: Tensor, T_normal_F: Tensor, T_normal_B: Tensor, body_mask: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Tensors (N, planes, H, W) as :func:`soar.networks.normal_inputs.assemble` makes them.

        Returns:
            front and back normals (N, 3, H, W) of unit length; they mean something inside the mask only.
        """
        change = self.unet(torch.cat([image, mask, T_normal_F, T_normal_B, body_mask], 1))
        front, back = change.split(3, 1)
        return unit(T_normal_F + front), unit(T_normal_B + back)


def unit(normals: Tensor) -> Tensor:
    """(N, 3, H, W) divided by their length; near zero they shrink to zero instead of becoming NaN."""
    return normals * (normals.square().sum(1, keepdim=True) + 1e-8).rsqrt()
