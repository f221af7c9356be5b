"""Normal maps: the cosine term, and the picture of a normal map that a perceptual distance is asked about."""

from __future__ import annotations

from torch import Tensor


def normalise(planes: Tensor) -> Tensor:
    """Planes (3, H, W) of unit length along the first axis; zero stays zero. Written out: reducing it is slow."""
    x, y, z = planes.unbind(0)
    return planes * (x * x + y * y + z * z + 1e-12).rsqrt()


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Per-pixel inner product (H, W) of planes (3, H, W)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cosine(rendered: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Mean of 1 - cos over the masked pixels that have a target (the paper's l_normal prints N.N^; 1 - cos is meant).

    Args:
        rendered: (3, H, W) accumulated normals of any length, camera space; the back pass's point away from the camera,
            as the stored back maps do, so no sign is changed here.
        target: (3, H, W) unit normals; zero where none is known.
        mask: (H, W) weights of the pixels to compare.
    """
    weight = mask * (dot(target, target) > 0.5)
    return ((1 - dot(normalise(rendered), target)) * weight).sum() / weight.sum().clamp_min(1)


def picture(normals: Tensor) -> Tensor:
    """Normals (3, H, W) in camera space (x right, y down, z forward) as the usual picture in [0, 1].

    The networks' convention is x right, y up, z towards the viewer: y and z change sign, for both sides alike.
    """
    return (normals * normals.new_tensor([1.0, -1.0, -1.0])[:, None, None] + 1) / 2
