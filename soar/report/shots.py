"""A rendered avatar as the numpy images that pictures and metrics use."""

from __future__ import annotations

import dataclasses

import numpy as np

from soar.avatar.puppet import Puppet
from soar.optimise.views import Views
from soar.raster import Rendered
from soar.report.pictures import colour_normals, colour_occlusion, composite


@dataclasses.dataclass(frozen=True)
class Shot:
    """One look at an avatar.

    Attributes:
        colour: (H, W, 3) float32 sRGB in [0, 1], not premultiplied; 0 where nothing was hit.
        alpha: (H, W) coverage in [0, 1].
        normal: (H, W, 3) unit camera-space normals, 0 where nothing was hit.
        occlusion: (H, W) tau of the visible surface in [0, 1]; 0 where nothing was hit.
    """

    colour: np.ndarray
    alpha: np.ndarray
    normal: np.ndarray
    occlusion: np.ndarray

    @staticmethod
    def of(rendered: Rendered) -> Shot:
        """Divide the accumulated planes by their coverage."""
        alpha = rendered.alpha.detach().cpu().numpy()
        share = np.where(alpha > 1e-3, 1.0 / np.maximum(alpha, 1e-3), 0.0)[..., None]
        colour, normal = (p.detach().permute(1, 2, 0).cpu().numpy() for p in (rendered.colour, rendered.normal))
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return Shot(
            np.clip(colour * share, 0.0, 1.0),
            np.clip(alpha, 0.0, 1.0),
            np.where(share > 0, normal / np.maximum(length, 1e-6), 0.0),
            np.clip(rendered.occlusion.detach().cpu().numpy() * share[..., 0], 0.0, 1.0),
        )

    @staticmethod
    def beside(views: Views, index: int, puppet: Puppet) -> Shot:
        """The avatar at the instant and through the camera of crop ``index``."""
        return Shot.of(puppet.render(int(views.frames[index]), views.T_cam_from_world, views.pinhole(index)))

    def on_white(self) -> np.ndarray:
        """(H, W, 3) float32 picture on white."""
        return composite(self.colour, self.alpha)

    def normals_on_white(self) -> np.ndarray:
        """(H, W, 3) float32 coloured normals on white."""
        return composite(colour_normals(self.normal), self.alpha)

    def occlusion_on_white(self) -> np.ndarray:
        """(H, W, 3) uint8 coloured occlusion on white: red was never seen."""
        return colour_occlusion(self.occlusion, self.alpha)
