"""Pictures and ground truth of dressed people, by the native steps dress, pose and draw."""

from __future__ import annotations

import ctypes
import dataclasses

import numpy as np
import torch
from torch import Tensor

from soar.errors import InputError
from soar.networks.prior_inputs import CANONICAL_CENTRE
from soar.raster.types import Pinhole
from soar.synthetic import native
from soar.synthetic.records import Light, pack
from soar.synthetic.settings import RenderSettings
from soar.synthetic.subject import Subject
from soar.synthetic.wardrobe import Wardrobe


@dataclasses.dataclass(frozen=True)
class Maps:
    """One side of a view; planes are (H, W) or (3, H, W) float32, zero where nothing is.

    Attributes:
        colour: sRGB of the clothed person, not multiplied by alpha.
        normal: clothed normals, unit, camera space; n_z < 0 in front maps, > 0 in back maps.
        alpha: share of the pixel that the clothed person covers.
        depth: z of the clothed surface, metres.
        layer: (H, W) int32 number in :data:`~soar.synthetic.records.LAYERS`, -1 where nothing is.
        body_normal, body_alpha, body_depth: the same of the naked body in the same pose.
        place: canonical coordinates in [-1, 1]: where the naked body's surface there lies on the mean shape at rest, in
            a cube of 2 m about :data:`~soar.networks.prior_inputs.CANONICAL_CENTRE`.
    """

    colour: Tensor
    normal: Tensor
    alpha: Tensor
    depth: Tensor
    layer: Tensor
    body_normal: Tensor
    body_alpha: Tensor
    body_depth: Tensor
    place: Tensor


@dataclasses.dataclass(frozen=True)
class Dressed:
    """A person whose layers are cut and stand off, (V,) metres each of V layer vertices; ``rest`` (P, 3): the shape."""

    subject: Subject
    record: np.ndarray
    betas: np.ndarray
    rest: np.ndarray
    kept: np.ndarray
    push: np.ndarray


@dataclasses.dataclass(frozen=True)
class Posed:
    """A dressed person in a pose under a light. V layer vertices; layers that are not worn hold nothing of use.

    Attributes:
        dressed: who.
        light: the light's floats.
        vertices, normals: (V, 3) world, metres; unit.
        sky, shadow: (V,) shares of sky and key light that arrive.
        crease: (V,) strength of folds.
    """

    dressed: Dressed
    light: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    sky: np.ndarray
    shadow: np.ndarray
    crease: np.ndarray


class Renderer:
    """Draws people from a wardrobe. Calls are independent of each other and may run in several threads.

    Args:
        wardrobe: the static record.
        settings: samples.
        threads: of one call to :meth:`draw`; the pixels do not depend on it.
    """

    def __init__(self, wardrobe: Wardrobe, settings: RenderSettings, threads: int = 1) -> None:
        self.wardrobe, self.settings, self.threads = wardrobe, settings, threads
        self._native = native.people()

    def dress(self, subject: Subject) -> Dressed:
        """Shape the body, cut and lay out the clothes; once per person.

        Raises:
            InputError: the shape has another number of components than the body.
        """
        struct = self.wardrobe.struct
        betas = np.ascontiguousarray(subject.betas, np.float32)
        if betas.shape != (struct.betas,):
            raise InputError("a shape does not fit the body", expected=f"({struct.betas},)", got=str(betas.shape))
        dressed = Dressed(
            subject, pack(subject.person), betas, np.zeros((struct.points, 3), np.float32),
            np.zeros(struct.vertices, np.float32), np.zeros(struct.vertices, np.float32),
        )  # fmt: skip
        done = self._native.soar_people_dress(
            struct, dressed.record.ctypes.data, betas.ctypes.data, self._dress_struct(dressed)
        )
        self._check(done)
        return dressed

    def pose(self, dressed: Dressed, pose: np.ndarray, translation: np.ndarray, light: Light) -> Posed:
        """Pose a person; once per pose and light, for any number of views.

        Args:
            dressed: who.
            pose: (J, 3) axis-angle, radians, as in :class:`~soar.body.motion.BodyMotion`.
            translation: (3,) metres.
            light: of the world.

        Raises:
            InputError: an array has another shape.
        """
        joints = len(self.wardrobe.body.joint_names)
        pose = np.ascontiguousarray(pose, np.float32)
        translation = np.ascontiguousarray(translation, np.float32)
        if pose.shape != (joints, 3) or translation.shape != (3,):
            got = f"{pose.shape}, {translation.shape}"
            raise InputError("a pose does not fit the body", expected=f"({joints}, 3), (3,)", got=got)
        count = self.wardrobe.struct.vertices
        posed = Posed(
            dressed, pack(light), np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32),
            *(np.zeros(count, np.float32) for _ in range(3)),
        )  # fmt: skip
        done = self._native.soar_people_pose(
            self.wardrobe.struct, dressed.record.ctypes.data, self._dress_struct(dressed), dressed.betas.ctypes.data,
            pose.ctypes.data, translation.ctypes.data, posed.light.ctypes.data, self._posed_struct(posed),
        )  # fmt: skip
        self._check(done)
        return posed

    def draw(
        self, posed: Posed, pinhole: Pinhole, T_cam_from_world: np.ndarray, back: bool = False
    ) -> tuple[Maps, Maps | None]:
        """One view: the nearest surfaces and, if asked for, the farthest along the same rays.

        Args:
            posed: who, where.
            pinhole: intrinsics and size.
            T_cam_from_world: (4, 4).
            back: draw the farthest surfaces too.
        """
        T = np.asarray(T_cam_from_world, np.float32)[:3].ravel()
        view = native.View(
            pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, (ctypes.c_float * 12)(*T.tolist()), pinhole.width,
            pinhole.height, self.settings.samples,
        )  # fmt: skip
        sides = [self._empty(pinhole) for _ in range(1 + back)]
        structs = [
            native.Maps(**{target: getattr(maps, source).data_ptr() for target, source in _PLANES}) for maps in sides
        ]
        done = self._native.soar_people_draw(
            self.wardrobe.struct, posed.dressed.record.ctypes.data, self._dress_struct(posed.dressed),
            self._posed_struct(posed), posed.light.ctypes.data, view, structs[0], structs[1] if back else None,
                self.threads,
        )  # fmt: skip
        self._check(done)
        centre = torch.tensor(CANONICAL_CENTRE)[:, None, None]
        for maps in sides:
            maps.place.sub_(centre).mul_(maps.body_alpha > 0)
        return sides[0], sides[1] if back else None

    def body_vertices(self, posed: Posed) -> np.ndarray:
        """(V, 3) world vertices of the naked body, in the body record's order."""
        return posed.vertices[self.wardrobe.layer_slices["body"]]

    @staticmethod
    def _empty(pinhole: Pinhole) -> Maps:
        shape = (pinhole.height, pinhole.width)
        planes = {name: torch.empty((3, *shape)) for name in ("colour", "normal", "body_normal", "place")}
        planes |= {name: torch.empty(shape) for name in ("alpha", "depth", "body_alpha", "body_depth")}
        return Maps(**planes, layer=torch.empty(shape, dtype=torch.int32))

    @staticmethod
    def _dress_struct(dressed: Dressed) -> native.Dress:
        return native.Dress(*(a.ctypes.data for a in (dressed.rest, dressed.kept, dressed.push)))

    @staticmethod
    def _posed_struct(posed: Posed) -> native.Posed:
        arrays = (posed.vertices, posed.normals, posed.sky, posed.shadow, posed.crease)
        return native.Posed(*(array.ctypes.data for array in arrays))

    @staticmethod
    def _check(done: int) -> None:
        if not done:
            raise MemoryError("drawing a person ran out of memory")


# Struct field, field of Maps.
_PLANES = (
    ("colour", "colour"), ("normal", "normal"), ("alpha", "alpha"), ("depth", "depth"), ("layer", "layer"),
    ("skin_normal", "body_normal"), ("skin_alpha", "body_alpha"), ("skin_depth", "body_depth"), ("place", "place"),
)  # fmt: skip


def visible_points(
    maps: Maps,
    pinhole: Pinhole,
    T_cam_from_world: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    """Which points of the naked body's surface a view sees.

    Args:
        maps: front maps of the view.
        pinhole, T_cam_from_world: of the view.
        points, normals: (N, 3) world, metres; unit.
        tolerance: how far, metres, a point may lie behind the drawn depth, besides what a slanting surface falls off
            within a pixel.

    Returns:
        (N,) bool: inside the picture, facing the camera, and not behind another part of the body.
    """
    T = np.asarray(T_cam_from_world, np.float64)
    p, n = points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
    ahead = p[:, 2] > 1e-3
    z = np.where(ahead, p[:, 2], 1.0)
    column = np.floor(pinhole.fx * p[:, 0] / z + pinhole.cx).astype(np.int64)
    row = np.floor(pinhole.fy * p[:, 1] / z + pinhole.cy).astype(np.int64)
    inside = ahead & (column >= 0) & (column < pinhole.width) & (row >= 0) & (row < pinhole.height)
    depth = maps.body_depth.numpy()
    found = depth[row.clip(0, pinhole.height - 1), column.clip(0, pinhole.width - 1)]
    cosine = -(n * p).sum(1) / np.linalg.norm(p, axis=1)
    slope = np.sqrt(1 - np.clip(cosine, 0.1, 1) ** 2) / np.clip(cosine, 0.1, 1)
    reach = tolerance + slope * p[:, 2] / pinhole.fx
    return inside & (cosine > 0) & (found > 0) & (p[:, 2] < found + reach)
