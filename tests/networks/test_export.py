"""The exported file computes what the network computes, and the loader refuses what it should."""

import dataclasses

import numpy as np
import onnx
import pytest
import torch

from soar.artifacts import read_json, sha256_file
from soar.errors import ConfigError, ModelFileError
from soar.models.onnx import ANY, Signature, session
from soar.networks import export as exporter
from soar.networks.export import difference, export
from soar.networks.normal_inputs import SIGNATURE
from tests.networks.small import network


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("network") / "normals.onnx"
    export(network(), SIGNATURE, 16, path, {"licence": "Apache-2.0"})
    return path


def rounded():
    made = network()
    for value in made.state_dict().values():
        value.copy_(value.half().float())
    return made


def test_file_equals_the_network_at_batches_and_sizes(exported):
    assert difference(rounded(), SIGNATURE, exported, 16) < 1e-4
    assert difference(rounded(), SIGNATURE, exported, 24) < 1e-4
    assert difference(network(seed=1), SIGNATURE, exported, 16) > 1e-2  # the comparison sees another network


def test_weights_are_stored_in_half_precision(exported):
    model = onnx.load(exported)
    sizes = {tensor.data_type: 0 for tensor in model.graph.initializer}
    for tensor in model.graph.initializer:
        sizes[tensor.data_type] += int(np.prod(tensor.dims))
    parameters = sum(value.numel() for value in network().parameters())
    assert sizes[onnx.TensorProto.FLOAT16] > 0.95 * parameters  # equal ones (of normalisations) are stored once
    assert sizes.get(onnx.TensorProto.FLOAT, 0) < 100
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]


def test_record_names_hash_shapes_and_facts(exported):
    record = read_json(exported.parent / "records" / "normals.onnx.json")
    assert record["sha256"] == sha256_file(exported)
    assert record["inputs"]["image"] == [None, 3, None, None]
    assert list(record["outputs"]) == ["nml_B", "nml_F"]
    assert record["licence"] == "Apache-2.0"
    assert record["difference_to_torch"] < 1e-3


def test_loader_refuses_an_altered_file(exported, tmp_path):
    (tmp_path / "records").mkdir()
    for name in ("normals.onnx", "records/normals.onnx.json"):
        (tmp_path / name).write_bytes((exported.parent / name).read_bytes())
    session(tmp_path / "normals.onnx", 1, SIGNATURE)
    content = bytearray((tmp_path / "normals.onnx").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "normals.onnx").write_bytes(content)
    with pytest.raises(ModelFileError, match="not the file it should be"):
        session(tmp_path / "normals.onnx", 1, SIGNATURE)


@pytest.mark.parametrize(
    ("side", "name", "shape"),
    [
        ("inputs", "image", (None, 4, None, None)),
        ("inputs", "image", (None, None, None, None)),  # the file's 3 is not free
        ("inputs", "image", (None, 3, None)),
        ("inputs", "picture", (None, 3, None, None)),
        ("outputs", "nml_F", (None, 1, None, None)),
        ("outputs", "depth", (None, 1, None, None)),
    ],
)
def test_loader_refuses_another_signature(exported, side, name, shape):
    wrong = dataclasses.replace(SIGNATURE, **{side: {**getattr(SIGNATURE, side), name: shape}})
    with pytest.raises(ModelFileError, match=f"other {side}"):
        session(exported, 1, wrong)


def test_a_free_axis_takes_any_size_and_others_may_follow(exported):
    loose = dataclasses.replace(SIGNATURE, inputs={**SIGNATURE.inputs, "image": (1, ANY, 512, ANY)})
    session(exported, 1, loose)
    few = dataclasses.replace(SIGNATURE, outputs={"nml_F": SIGNATURE.outputs["nml_F"]})
    with pytest.raises(ModelFileError, match="other outputs"):
        session(exported, 1, few)
    session(exported, 1, dataclasses.replace(few, others_may_follow=True))


def test_devices(exported, monkeypatch):
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])
    session(exported, 1, device="auto")
    with pytest.raises(ConfigError, match="unknown device"):
        session(exported, 1, device="gpu")
    with pytest.raises(ConfigError, match="no CUDA"):
        session(exported, 1, device="cuda")


def test_loader_refuses_another_type(tmp_path):
    class Whole(torch.nn.Module):
        def forward(self, x):
            return (x * 2).to(torch.int64)

    path = tmp_path / "whole.onnx"
    axes = {"x": {0: "n"}, "y": {0: "n"}}
    torch.onnx.export(
        Whole(), (torch.ones(1, 2),), str(path), dynamo=False, input_names=["x"], output_names=["y"], dynamic_axes=axes
    )
    with pytest.raises(ModelFileError, match="other outputs"):
        session(path, 1, Signature({"x": (None, 2)}, {"y": (None, 2)}))


def test_export_that_differs_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(exporter, "TOLERANCE", 1e-9)
    with pytest.raises(ModelFileError, match="would not compute"):
        export(network(), SIGNATURE, 16, tmp_path / "normals.onnx", {})
    assert not list(tmp_path.glob("*.onnx"))


def test_export_that_gives_no_numbers_is_refused(tmp_path):
    """The root of noise is not a number somewhere, in the network and in the file alike."""

    class Root(torch.nn.Module):
        def forward(self, x):
            return (x.sqrt(),)

    signature = Signature({"x": (None, 3, None, None)}, {"y": (None, 3, None, None)})
    with pytest.raises(ModelFileError, match="would not compute"):
        export(Root(), signature, 8, tmp_path / "root.onnx", {})


def test_checked_inputs_have_times_and_flags_that_occur():
    """A prior whose flags are noise would never use what it copies."""
    shapes = {"time": (None,), "flags": (None, 3), "image": (None, 3, 4, 4)}
    one, two = (exporter._noise(Signature(shapes, {}), count, 4, 4) for count in (1, 2))
    for time, flags, image in (one, two):
        assert 0 <= time.min() <= time.max() <= 1
        assert set(flags.unique().tolist()) <= {0, 1}
        assert image.std() > 0.5
    assert one[1].tolist() == [[1, 1, 1]]
    assert two[1].tolist() == [[1, 1, 1], [0, 0, 0]]
