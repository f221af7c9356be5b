"""The reconstruction objective (paper, section 3.2): what one step compares, term by term."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch
from torch import Tensor

from soar.avatar.surfels import Avatar
from soar.losses.lpips import Features, Lpips
from soar.losses.normal import cosine, picture
from soar.losses.photometric import SsimTarget, l1, ssim
from soar.losses.regularise import curvature, normal_depth, offset, offset_laplacian, scale_log, scale_mean
from soar.optimise.views import Views
from soar.raster import Rendered


@dataclasses.dataclass(frozen=True)
class Weights:
    """Weight of every term; a term of weight 0 is not computed."""

    l1: float
    ssim: float
    lpips: float
    mask: float
    mask_back: float
    normal_cosine: float
    normal_lpips: float
    normal_depth: float
    curvature: float
    offset: float
    laplacian: float
    scale_mean: float
    scale_log: float


class Targets:
    """What each crop is compared with, and the perceptual features of it, kept while they fit in ``cache_mb``.

    Args:
        views: the observed crops.
        lpips: the perceptual distance; may be None where its weights are zero.
        cache_mb: memory for features, in MiB; beyond it they are computed again at every visit.
    """

    def __init__(self, views: list[Views], lpips: Lpips | None, cache_mb: int) -> None:
        self.views, self.lpips, self._room = views, lpips, cache_mb * 2**20
        self._kept: dict[tuple[int, int, str], Features] = {}

    def features(self, view: int, index: int, what: str, picture_of: Callable[[], Tensor]) -> Features:
        """Features of the image (3, H, W) that ``picture_of()`` makes, cached under (view, index, what)."""
        key = (view, index, what)
        if key in self._kept:
            return self._kept[key]
        assert self.lpips is not None
        with torch.no_grad():
            features = self.lpips.features(picture_of()[None])
        size = sum(f.numel() * f.element_size() for f in features)
        if size <= self._room:
            self._room -= size
            self._kept[key] = features
        return features


def image_terms(
    front: Rendered, back: Rendered, targets: Targets, view: int, index: int, background: Tensor, weights: Weights
) -> dict[str, Tensor]:
    """The unweighted terms that compare renders with one crop; means over the crop, or over the mask for normals.

    Args:
        front, back: the two passes, on black.
        targets: the observations.
        view, index: which crop.
        background: (3,) colour put behind render and photograph alike, another one at each step.
        weights: says which terms to compute.
    """
    views = targets.views[view]
    mask = views.mask(index)
    photograph = views.image(index) * mask
    share = views.share(index)
    behind = background[:, None, None]
    # Where a surfel covers what the mask calls background, the target is a random colour: alpha shall learn from it,
    # the surfel's colour shall not, or the rims turn grey.
    image = front.colour * mask + front.colour.detach() * (1 - mask) + (1 - front.alpha) * behind
    wanted = photograph + (1 - mask) * behind
    terms: dict[str, Tensor] = {}
    if weights.l1:
        terms["l1"] = share * l1(image, wanted)
    if weights.ssim:
        terms["ssim"] = share * (1 - ssim(image, SsimTarget.of(wanted)))
    if weights.mask:
        terms["mask"] = share * l1(front.alpha, mask)
    if weights.mask_back:
        terms["mask_back"] = share * l1(back.alpha, mask)
    # Perceptual pairs: rendered picture, and the name and maker of its target. Inside the mask, on black, so that
    # the target does not change with the background.
    pairs: list[tuple[Tensor, Features]] = []
    shares: list[str] = []
    if weights.lpips:
        pairs.append((front.colour * mask, targets.features(view, index, "photograph", lambda: photograph)))
        shares.append("lpips")
    if weights.normal_cosine or weights.normal_lpips:
        cos: list[Tensor] = []
        for name, rendered, normals in zip(("front", "back"), (front, back), views.normal_maps(index), strict=True):
            cos.append(cosine(rendered.normal, normals, mask))
            if weights.normal_lpips:
                wanted_picture = picture(normals) * mask
                pairs.append(
                    (picture(rendered.normal) * mask, targets.features(view, index, name, lambda p=wanted_picture: p))
                )
                shares.append("normal_lpips")
        if weights.normal_cosine:
            terms["normal_cosine"] = cos[0] + cos[1]
    if pairs:
        assert targets.lpips is not None
        wanted_features = [torch.cat(level) for level in zip(*(f for _, f in pairs), strict=True)]
        distances = targets.lpips.distance(targets.lpips.features(torch.stack([p for p, _ in pairs])), wanted_features)
        for name, distance in zip(shares, distances, strict=True):
            terms[name] = share * distance + terms.get(name, 0.0)
    if weights.normal_depth:
        terms["normal_depth"] = normal_depth(front.normal, front.depth, front.alpha, views.pinhole(index))
    if weights.curvature:
        terms["curvature"] = curvature(front.normal, front.alpha)
    return terms


def surface_terms(
    positions: Tensor, scales: Tensor, start: Avatar, ring: Tensor, weights: Weights
) -> dict[str, Tensor]:
    """The unweighted terms on the canonical surface itself.

    Args:
        positions: (N, 3) canonical, metres.
        scales: (N,) metres.
        start: the avatar the offsets and radii are measured from.
        ring: (N, k) indices of the neighbours of each surfel at rest.
        weights: says which terms to compute.
    """
    terms: dict[str, Tensor] = {}
    if weights.offset:
        terms["offset"] = offset(positions, start.rest_positions)
    if weights.laplacian:
        terms["laplacian"] = offset_laplacian(positions, start.rest_positions, ring)
    if weights.scale_mean:
        terms["scale_mean"] = scale_mean(scales)
    if weights.scale_log:
        terms["scale_log"] = scale_log(scales, start.scales)
    return terms
