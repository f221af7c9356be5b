"""What a renderer knows of the posed body in a view: the planes that priors are told besides pictures."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from soar.body.record import BodyModel
from soar.geometry.meshes import vertex_normals
from soar.networks.prior_inputs import CANONICAL_CENTRE
from soar.raster import Pinhole, rasterise_mesh

_SAMPLES = 2  # per side of a pixel, as the prior was taught (conf/synthetic)
_LEAST_Z = 0.02  # of a normal towards the camera, as soar/raster/native/people_draw.cpp holds it


class BodyGeometry:
    """Renders a body's place, normals and alpha.

    Args:
        body: the model whose posed vertices will be rendered. Places are coordinates on the default body's mean shape
            at rest, which the bundled prior was taught with, whatever the body.
    """

    def __init__(self, body: BodyModel) -> None:
        self.faces = body.faces[~body.interior]
        self.place = (body.places() - body.v_template.new_tensor(CANONICAL_CENTRE)).cpu()

    def normals(self, vertices: Tensor) -> Tensor:
        """(V, 3) outward unit normals of posed vertices (V, 3)."""
        return vertex_normals(vertices, self.faces)

    def planes(self, vertices: Tensor, normals: Tensor, pinhole: Pinhole) -> Tensor:
        """The geometry (7, H, W) of :mod:`soar.networks.prior_inputs`, on the processor.

        Args:
            vertices: (V, 3) metres, camera space.
            normals: (V, 3) of them, camera space.
            pinhole: the view.
        """
        fine = enlarged(pinhole, _SAMPLES)
        seen = rasterise_mesh(vertices, self.faces, fine, "front")
        hit = seen.face >= 0
        corners = self.faces.cpu()[seen.face.clamp_min(0).long()]
        weights = (seen.barycentrics * hit[..., None])[..., None]
        normal = normalize((normals.cpu()[corners] * weights).sum(-2), dim=-1)
        # As the prior was taught: smooth normals that lean over the rim are held on the drawn side.
        normal = torch.cat([normal[..., :2], normal[..., 2:].clamp_max(-_LEAST_Z)], -1)
        normal = normalize(normal, dim=-1) * hit[..., None]
        place = (self.place[corners] * weights).sum(-2)
        nearest = _squares(torch.where(hit, seen.depth, torch.inf)).argmin(-1, keepdim=True)
        place = torch.stack([_squares(p).gather(-1, nearest)[..., 0] for p in place.unbind(-1)])
        normal = normalize(torch.stack([_squares(n).sum(-1) for n in normal.unbind(-1)]), dim=0)
        return torch.cat([place, normal, _squares(hit.float()).mean(-1)[None]])


def enlarged(pinhole: Pinhole, times: float) -> Pinhole:
    """The same view with ``times`` as many pixels on a side."""
    size = round(pinhole.width * times), round(pinhole.height * times)
    return Pinhole(*(times * value for value in (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)), *size)


def _squares(plane: Tensor) -> Tensor:
    """(H n, W n) to (H, W, n n): the samples of each pixel."""
    rows = plane.unflatten(0, (-1, _SAMPLES)).unflatten(2, (-1, _SAMPLES))
    return rows.transpose(1, 2).flatten(2)
