"""The body occlusion ratio: how much of a body its training footage never shows."""

from __future__ import annotations

from torch import Tensor


def body_occlusion_ratio(occlusion: Tensor, scales: Tensor) -> tuple[float, float]:
    """Mean tau over the surfels (the paper's BOR), and weighted by surfel area.

    The plain mean depends on where the mesh is dense (hands and face); compare bodies by the weighted one.

    Args:
        occlusion: (N,) tau in [0, 1]; 1 = never seen.
        scales: (N,) radii, metres.
    """
    tau, area = occlusion.double(), scales.double().square()
    return float(tau.mean()), float((tau * area).sum() / area.sum())
