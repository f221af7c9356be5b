"""Where a photograph shows which region of the body: head top, face, trunk, and bands along arms and legs."""

from __future__ import annotations

import cv2
import numpy as np

from soar.body.parts import bone_name, bones_of_vertices, without_side
from soar.body.record import BodyModel
from soar.caption.records import Sighting
from soar.networks.normal_inputs import fill, nearest_known
from soar.raster import rasterise_mesh
from soar.raster.types import Backend

BANDS = 10
"""Bands of an arm, shoulder to wrist, and of a leg, hip to ankle; half of them end at elbow and knee."""

ARMS = tuple(f"arm {band}" for band in range(BANDS))
LEGS = tuple(f"leg {band}" for band in range(BANDS))
REGIONS = ("top of head", "face", "chest", "belly", "hips", "hands", "feet", *ARMS, *LEGS)

NOWHERE = -1

# Shares of the head's height, chin to crown; of the trunk's, hips to shoulders; of the foot's length, heel to toes.
_HAIRLINE, _FACE, _NAPE = 0.82, (0.15, 0.6), 0.45
_CHEST, _BELLY, _HIPS = (0.5, 0.85), (0.2, 0.45), (-0.15, 0.05)
_INSTEP = 0.7

_LIMBS = {"upperarm01": ("lowerarm01", ARMS), "lowerarm01": ("wrist", ARMS), "upperleg01": ("lowerleg01", LEGS)}
_LIMBS["lowerleg01"] = ("foot", LEGS)


class RegionFinder:
    """Finds the regions of one body in photographs.

    Args:
        body: the model; its large bones are known to :mod:`soar.body.parts`.
        margin: share of a crop's height, around limbs and mask, that is nowhere: pixels there mix two things.
        reach: share of a crop's height by which clothes and hair may stand out from the body.
        backend: of the z-buffer.

    Raises:
        ModelFileError: the bones are called otherwise.
    """

    def __init__(self, body: BodyModel, margin: float, reach: float, backend: Backend) -> None:
        self.faces = body.faces[~body.interior]
        self.regions, self.bones = _labels(body)
        self.margin, self.reach, self.backend = margin, reach, backend

    def __call__(self, sighting: Sighting) -> np.ndarray:
        """(H, W) index into :data:`REGIONS` of what each pixel of the person shows, or :data:`NOWHERE`."""
        seen = rasterise_mesh(sighting.vertices, self.faces, sighting.pinhole, "front", self.backend)
        on = (seen.face >= 0).numpy()
        corner = self.faces[seen.face.long()].gather(2, seen.barycentrics.argmax(-1, keepdim=True))[..., 0].numpy()
        both = np.stack([self.regions[corner], self.bones[corner]], -1)
        person = sighting.alpha > 250
        near = cv2.distanceTransform(np.uint8(~on), cv2.DIST_L2, cv2.DIST_MASK_5) <= self.reach * len(on)
        both = fill(both, nearest_known(on, person & near))
        known = person & (on | near)
        side = 2 * max(1, round(self.margin * len(on))) + 1
        kernel = np.ones((side, side), np.uint8)
        bones = np.where(known, both[..., 1], 255).astype(np.uint8)
        alike = cv2.dilate(bones, kernel) == cv2.erode(bones, kernel)
        return np.where(known & alike, both[..., 0], NOWHERE)


def _labels(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """(V,) region and (V,) large bone of each vertex; arms and legs of both sides share their regions."""
    names = np.array(bones_of_vertices(body))
    kinds = np.array([without_side(name) for name in names])
    v, up, front = (t.numpy() for t in (body.v_template, body.up, body.front))
    joints = dict(zip(map(bone_name, body.joint_names), body.J_template.numpy(), strict=True))
    regions = np.full(len(v), NOWHERE)

    def put(where: np.ndarray, region: str) -> None:
        regions[where] = REGIONS.index(region)

    height = v @ up
    head = kinds == "head"
    low, high = height[head].min(), height[head].max()
    share, ahead = (height - low) / (high - low), v @ front - (v[head] @ front).mean()
    put(head & (share > _FACE[0]) & (share < _FACE[1]) & (ahead > 0), "face")
    put(head & ((share > _HAIRLINE) | ((share > _NAPE) & (ahead < 0))), "top of head")

    hips, shoulders = (
        np.mean([p @ up for name, p in joints.items() if without_side(name) == bone])
        for bone in ("upperleg01", "upperarm01")
    )
    trunk, share = np.isin(kinds, ("spine04", "root")), (height - hips) / (shoulders - hips)
    for region, (start, end) in (("chest", _CHEST), ("belly", _BELLY), ("hips", _HIPS)):
        put(trunk & (share > start) & (share < end), region)

    put(kinds == "wrist", "hands")
    for name in ("foot.L", "foot.R"):  # without the heel, above which shoes may leave the foot bare
        ahead = v @ front
        low, high = ahead[names == name].min(), ahead[names == name].max()
        put((names == name) & ((ahead - low) / (high - low) > _INSTEP), "feet")
    for name in set(names[np.isin(kinds, list(_LIMBS))].tolist()):
        kind, suffix = without_side(name), name[len(without_side(name)) :]
        following, bands = _LIMBS[kind]
        start, along = joints[name], joints[following + suffix] - joints[name]
        share = np.clip((v - start) @ along / (along @ along), 0, 1 - 1e-6)
        first = 0 if kind.startswith("upper") else BANDS // 2
        for band in range(BANDS // 2):
            put((names == name) & (np.floor(share * (BANDS // 2)) == band), bands[first + band])
    _, bones = np.unique(names, return_inverse=True)
    return regions, bones
