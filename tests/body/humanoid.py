"""A model file of the official form that has the shape of a person: an ellipsoid for every bone of SMPL-X's skeleton.

Positions are rough measures of a standing adult, made up for these tests; of the official model it has the counts, the
names and the numbers of the vertices that are keypoints.
"""

from __future__ import annotations

import functools

import numpy as np
import trimesh

from soar.body.smplx import EXTRA_VERTICES
from soar.body.smplx_file import FACES, JOINTS, PARENTS, VERTICES
from tests.body.official import kintree

RINGS, SEGMENTS = 8, 18  # of an ellipsoid

# Metres; x to the left, y up, z to the front, the right side is the mirror image.
_MIDDLE = {
    "pelvis": (0, -0.35, 0), "spine1": (0, -0.24, -0.03), "spine2": (0, -0.1, -0.03), "spine3": (0, -0.05, -0.01),
    "neck": (0, 0.16, -0.03), "head": (0, 0.31, 0.0), "jaw": (0, 0.3, 0.0),
}  # fmt: skip
_LEFT = {
    "hip": (0.06, -0.44, 0), "knee": (0.11, -0.82, -0.01), "ankle": (0.09, -1.24, -0.05), "foot": (0.12, -1.3, 0.07),
    "collar": (0.05, 0.08, -0.02), "shoulder": (0.17, 0.11, -0.02), "elbow": (0.43, 0.09, -0.05),
    "wrist": (0.68, 0.1, -0.05), "eye_smplhf": (0.032, 0.37, 0.08),
}  # fmt: skip
_KNUCKLES = {"index": 0.02, "middle": 0.0, "pinky": -0.045, "ring": -0.025}  # z, of fingers along x


@functools.cache
def joints() -> np.ndarray:
    """(55, 3) at rest."""
    places = {name: np.array(p, float) for name, p in _MIDDLE.items()}
    for side, sign in (("left", 1), ("right", -1)):
        own = {name: np.array(p, float) for name, p in _LEFT.items()}
        for finger, z in _KNUCKLES.items():
            own |= {f"{finger}{k}": np.array([0.75 + 0.03 * k, 0.09, z - 0.04]) for k in (1, 2, 3)}
        own |= {f"thumb{k}": np.array([0.68 + 0.025 * k, 0.09, -0.02 + 0.02 * k]) for k in (1, 2, 3)}
        places |= {f"{side}_{name}": p * (sign, 1, 1) for name, p in own.items()}
    return np.stack([places[name] for name in JOINTS])


def _bones() -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """(joint that moves it, start, end, radius) of each ellipsoid."""
    J, at = joints(), JOINTS.index
    bones = []
    for joint, name in enumerate(JOINTS):
        children = [c for c, parent in enumerate(PARENTS) if parent == joint]
        if "eye" in name:
            bones.append((joint, J[joint] - (0, 0.005, 0), J[joint] + (0, 0.005, 0), 0.012))
        elif name == "head":
            bones.append((joint, J[joint] + (0, -0.04, 0.02), J[joint] + (0, 0.18, 0.0), 0.085))
        elif name == "jaw":
            bones.append((joint, J[joint] + (0, -0.02, 0.03), J[joint] + (0, -0.03, 0.08), 0.03))
        elif not children:  # toes and finger tips
            ahead = np.array([0, 0, 0.1]) if "foot" in name else J[joint] - J[PARENTS[joint]]
            bones.append((joint, J[joint], J[joint] + ahead, 0.035 if "foot" in name else 0.008))
        for child in children:
            if "eye" in JOINTS[child] or JOINTS[child] == "jaw":
                continue
            wide = 0.13 if "spine" in name or name == "pelvis" else 0.05 if name == "neck" else 0.045
            bones.append((joint, J[joint], J[child], 0.008 if joint >= at("left_index1") else wide))
        if "ankle" in name:
            bones.append((joint, J[joint], J[joint] + (0, -0.06, -0.05), 0.035))
    return bones


def ball() -> tuple[np.ndarray, np.ndarray]:
    """A unit ball of RINGS x SEGMENTS + 2 vertices, poles along z."""
    up = np.pi * np.arange(1, RINGS + 1) / (RINGS + 1)
    round_ = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    ring = np.stack([np.outer(np.sin(up), np.cos(round_)), np.outer(np.sin(up), np.sin(round_))], -1)
    grid = np.concatenate([ring, np.broadcast_to(np.cos(up)[:, None, None], (RINGS, SEGMENTS, 1))], -1)
    vertices = np.concatenate([grid.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i, j = np.meshgrid(np.arange(RINGS - 1), np.arange(SEGMENTS), indexing="ij")
    a, b = (i * SEGMENTS + j).ravel(), (i * SEGMENTS + (j + 1) % SEGMENTS).ravel()
    sides = np.concatenate([np.stack([a, a + SEGMENTS, b], 1), np.stack([b, a + SEGMENTS, b + SEGMENTS], 1)])
    j = np.arange(SEGMENTS)
    following, last = (j + 1) % SEGMENTS, (RINGS - 1) * SEGMENTS
    north = np.stack([np.full(SEGMENTS, len(vertices) - 2), j, following], 1)
    south = np.stack([np.full(SEGMENTS, len(vertices) - 1), last + following, last + j], 1)
    return vertices, np.concatenate([sides, north, south])


@functools.cache
def mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (10475, 3), faces (20908, 3) and the joint (10475,) that moves each vertex.

    What is left to the official counts is filled with vertices without a face, and with faces that are there already.
    """
    unit, triangles = ball()
    vertices, faces, owner = [], [], []
    for joint, a, b, radius in _bones():
        frame = trimesh.geometry.align_vectors([0, 0, 1], b - a)[:3, :3]
        half = np.linalg.norm(b - a) / 2
        faces.append(triangles + len(unit) * len(vertices))
        vertices.append((unit * (radius, radius, half + radius / 2)) @ frame.T + (a + b) / 2)
        owner += [joint] * len(unit)
    v, f, o = np.concatenate(vertices), np.concatenate(faces), np.array(owner)
    spare = VERTICES - len(v)
    v, o = np.concatenate([v, v[:spare]]), np.concatenate([o, o[:spare]])
    f = np.concatenate([f, f[: FACES - len(f)]])
    assert (len(v), len(f)) == (VERTICES, FACES), (len(v), len(f))
    order = np.arange(VERTICES)  # place -> vertex
    for k, point in zip(EXTRA_VERTICES, _tips(), strict=True):
        nearest = int(np.linalg.norm(v[order] - point, axis=1).argmin())
        order[[k, nearest]] = order[[nearest, k]]
    place = np.argsort(order)
    return v[order], place[f], o[order]


def _tips() -> list[np.ndarray]:
    """Where the vertices that are joints 55 to 75 should be."""
    at = dict(zip(JOINTS, joints(), strict=True))
    wanted = [("head", 0, 0.03, 0.12), ("right_eye_smplhf", 0, 0, 0.02), ("left_eye_smplhf", 0, 0, 0.02)]
    wanted += [("head", -0.1, 0.05, 0), ("head", 0.1, 0.05, 0)]
    for side, sign in (("left", 1), ("right", -1)):
        wanted += [(f"{side}_foot", -sign * 0.02, 0, 0.15), (f"{side}_foot", sign * 0.04, 0, 0.1)]
        wanted.append((f"{side}_ankle", 0, -0.06, -0.1))
    tips = [
        2 * at[f"{side}_{finger}3"] - at[f"{side}_{finger}2"]
        for side in ("left", "right")
        for finger in ("thumb", "index", "middle", "ring", "pinky")
    ]
    return [at[name] + np.array(shift) for name, *shift in wanted] + tips


def arrays() -> dict[str, np.ndarray]:
    """The numeric arrays of a version 1.0 file of this person."""
    rng = np.random.default_rng(0)
    v, f, owner = mesh()
    J = joints()
    weights = np.eye(len(JOINTS))[owner]
    near = np.exp(-(np.linalg.norm(v - J[owner], axis=1) / 0.03))[:, None] / 2
    above = np.maximum(np.array(PARENTS)[owner], 0)
    weights = (1 - near) * weights + near * np.eye(len(JOINTS))[above]
    # A joint is the nearest mean of vertices about it that gives it exactly.
    regressor = np.zeros((len(JOINTS), VERTICES))
    for j, point in enumerate(J):
        some = np.argsort(np.linalg.norm(v - point, axis=1))[:400:4]
        system = np.concatenate([v[some].T - point[:, None], np.ones((1, len(some)))])
        regressor[j, some] = np.linalg.lstsq(system, np.array([0, 0, 0, 1.0]), rcond=None)[0]
    dirs = 0.002 * rng.standard_normal((1, 3, 20)) * np.sin(3 * v)[..., None]
    dirs[..., 0] = 0.06 * (v - J[0])  # taller
    dirs[..., 1] = 0.1 * v * (1, 0, 1)  # wider
    posedirs = 0.001 * rng.standard_normal((1, 3, 9 * (len(JOINTS) - 1))) * np.cos(5 * v)[..., None]
    components = np.stack([np.linalg.qr(rng.standard_normal((45, 45)))[0] for _ in range(2)])
    curl = np.zeros((15, 3))
    curl[:, 2] = -0.3
    landmarks, contour = _landmarks(v, f, owner)
    return {
        "v_template": v, "f": f.astype(np.uint32), "shapedirs": dirs, "posedirs": posedirs.astype(np.float32),
        "J_regressor": regressor, "weights": weights, "kintree_table": kintree(),
        "hands_componentsl": components[0], "hands_componentsr": components[1],
        "hands_meanl": curl.ravel(), "hands_meanr": (curl * (1, -1, -1)).ravel(),
        "lmk_faces_idx": landmarks, "lmk_bary_coords": np.full((51, 3), 1 / 3),
        "dynamic_lmk_faces_idx": np.tile(contour, (79, 1)), "dynamic_lmk_bary_coords": np.full((79, 17, 3), 1 / 3),
    }  # fmt: skip


def _landmarks(v: np.ndarray, f: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces under the landmarks 17 to 67, and under 0 to 16."""
    head = joints()[JOINTS.index("head")]

    def arc(left: float, right: float, height: float, bow: float, count: int) -> list[tuple[float, float]]:
        across = np.linspace(left, right, count)
        return [(x, height + bow * (1 - ((x - across.mean()) / 0.05) ** 2)) for x in across]

    flat = [
        *arc(-0.06, -0.02, 0.085, 0.01, 5), *arc(0.02, 0.06, 0.085, 0.01, 5),
        *((0.0, y) for y in np.linspace(0.06, 0.03, 4)), *arc(-0.02, 0.02, 0.02, -0.003, 5),
        *arc(-0.045, -0.02, 0.065, 0.004, 3), *arc(-0.02, -0.045, 0.055, -0.002, 3),
        *arc(0.02, 0.045, 0.065, 0.004, 3), *arc(0.045, 0.02, 0.055, -0.002, 3),
        *arc(-0.03, 0.03, -0.005, 0.01, 7), *arc(0.03, -0.03, -0.01, -0.01, 5),
        *arc(-0.02, 0.02, -0.005, 0.003, 5), *arc(0.015, -0.015, -0.01, -0.003, 3),
    ]  # fmt: skip
    angles = np.linspace(-np.pi / 2, np.pi / 2, 17)
    jaw = [(0.085 * np.sin(a), 0.05 - 0.09 * np.cos(a)) for a in angles]
    mine = np.flatnonzero((owner[f] == JOINTS.index("head")).all(1))
    centres = v[f[mine]].mean(1)
    ahead = centres[:, 2] > -0.01

    def under(points: list[tuple[float, float]]) -> np.ndarray:
        wanted = head[:2] + np.array(points)
        distance = np.linalg.norm(centres[None, ahead, :2] - wanted[:, None], axis=-1)
        return mine[ahead][distance.argmin(1)]

    return under(flat), under(jaw)
