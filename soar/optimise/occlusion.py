"""Which surfels no training frame ever shows: tau (paper, section 3.3)."""

from __future__ import annotations

import dataclasses
import math

import torch

from soar.avatar.articulate import Articulation
from soar.avatar.puppet import Puppet
from soar.avatar.surfels import Avatar
from soar.metrics.bor import body_occlusion_ratio
from soar.optimise.views import Views, epochs
from soar.progress import track
from soar.raster import RasterSettings, rasterise


@dataclasses.dataclass(frozen=True)
class OcclusionSettings:
    """The tau loop (``conf/occlusion``)."""

    steps: int
    visits: int
    rate: float
    start: float
    min_coverage: float
    undecided: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Occlusion:
    """Result of the tau loop.

    Attributes:
        avatar: with tau filled; 1 = never seen.
        bor: mean tau over the surfels, the paper's body occlusion ratio.
        bor_area: the same weighted by surfel area; does not depend on where the mesh is dense.
        undecided: share of surfels whose tau is neither seen nor unseen.
    """

    avatar: Avatar
    bor: float
    bor_area: float
    undecided: float


def occlusion(
    avatar: Avatar,
    articulation: Articulation,
    views: list[Views],
    settings: OcclusionSettings,
    raster: RasterSettings,
    seed: int,
) -> Occlusion:
    """Minimise the rendered occlusion over the training crops; everything but tau is detached.

    tau starts near 1 and only falls where a pixel shows the surfel, so what stays was never seen. Every crop is drawn
    ``visits`` times or more, since Adam's step after a single gradient does not carry a logit all the way. Surfels that
    face away are culled: without that the far side shines through between disks.

    Args:
        avatar: any avatar; its tau is ignored.
        articulation, views: the motion and the training crops.
        settings: ``min_coverage`` is the share of a surfel's own footprint that has to be visible in a frame to count
            as seen (0 = any, the paper).
        raster: of the rasteriser; culling is mandatory and switched on here.
        seed: of the crop order.
    """
    raster = dataclasses.replace(raster, cull=True)
    puppet = Puppet(avatar, articulation, raster)
    logits = torch.full_like(avatar.scales, math.log(settings.start / (1 - settings.start))).requires_grad_()
    optimiser = torch.optim.Adam([logits], lr=settings.rate, eps=1e-15)
    steps = max(settings.steps, settings.visits * sum(map(len, views)))
    for v, index in track(epochs(views, steps, torch.Generator().manual_seed(seed)), "occlusion"):
        view = views[v]
        pinhole = view.pinhole(index)
        with torch.no_grad():
            positions, normals = puppet.pose(int(view.frames[index]), view.T_cam_from_world)
        tau = logits.detach().sigmoid().requires_grad_()
        rendered = rasterise(
            positions, normals, avatar.scales, avatar.colours, tau, pinhole, side="front", settings=raster
        )
        (shown,) = torch.autograd.grad(rendered.occlusion.sum(), tau)
        if settings.min_coverage > 0:
            distance = positions.norm(dim=-1)
            cosine = (positions * normals).sum(-1).abs() / distance
            footprint = 2 * math.pi * avatar.scales.square() * pinhole.fx * pinhole.fy * cosine / distance.square()
            shown = torch.where(shown > settings.min_coverage * footprint, shown, 0)
        logits.grad = shown / rendered.occlusion.numel() * (tau * (1 - tau)).detach()
        optimiser.step()
    tau = logits.detach().sigmoid()
    bor, bor_area = body_occlusion_ratio(tau, avatar.scales)
    low, high = settings.undecided
    return Occlusion(
        avatar.replace(occlusion=tau),
        bor=bor,
        bor_area=bor_area,
        undecided=float(((tau > low) & (tau < high)).double().mean()),
    )
