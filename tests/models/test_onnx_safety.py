"""ONNX files that name what is not theirs, declare what they do not hold, or are none: refused before they are run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper

from soar.errors import ModelFileError
from soar.models import onnx_file
from soar.models.onnx import ANY, Signature, compare, session
from soar.models.onnx_file import Port, inspect
from soar.networks import DATA

WEIGHT = np.arange(6, dtype=np.float32).reshape(2, 3)


def network(weight: TensorProto | None = None, op: str = "MatMul", domain: str = "") -> onnx.ModelProto:
    """y = x @ weight, with x (N, 2) and y (N, 3)."""
    weight = numpy_helper.from_array(WEIGHT, "weight") if weight is None else weight
    graph = helper.make_graph(
        [helper.make_node(op, ["x", weight.name], ["y"], domain=domain)],
        "product",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["n", 2])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["n", 3])],
        [weight],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def external(location: str, dims: tuple[int, ...] = (2, 3), **entries: str) -> TensorProto:
    """A weight whose data are in another file."""
    tensor = TensorProto(name="weight", dims=dims, data_type=TensorProto.FLOAT, data_location=TensorProto.EXTERNAL)
    for key, value in {"location": location, **entries}.items():
        tensor.external_data.add(key=key, value=value)
    return tensor


def written(path: Path, model: onnx.ModelProto) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a file of data, below one with a secret; onnxruntime must not be reached."""
    for path in (tmp_path / "net" / "weight.bin", tmp_path / "secret.bin"):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(WEIGHT.tobytes())

    def opened(*_: object, **__: object) -> None:
        raise AssertionError("onnxruntime opened a file that should have been refused")

    monkeypatch.setattr(ort, "InferenceSession", opened)
    return tmp_path / "net"


def test_ports_are_read_without_running(tmp_path: Path) -> None:
    ports = inspect(written(tmp_path / "a.onnx", network()))
    assert ports.inputs == (Port("x", "tensor(float)", ("n", 2)),)
    assert ports.outputs == (Port("y", "tensor(float)", ("n", 3)),)
    assert str(ports.inputs[0]) == "x (n, 2) float"


@pytest.mark.parametrize("entries", [{}, {"offset": "0", "length": "24"}])
def test_data_beside_the_file_are_read(tmp_path: Path, entries: dict[str, str]) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "weight.bin").write_bytes(WEIGHT.tobytes())
    path = written(tmp_path / "a.onnx", network(external("parts/weight.bin", **entries)))
    (got,) = session(path, 1).run(["y"], {"x": np.eye(2, dtype=np.float32)})
    np.testing.assert_array_equal(got, WEIGHT)


def test_a_link_to_a_network_is_followed_with_its_data(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "weight.bin").write_bytes(WEIGHT.tobytes())
    real = written(tmp_path / "real" / "a.onnx", network(external("weight.bin")))
    link = tmp_path / "link.onnx"
    link.symlink_to(real)
    (got,) = session(link, 1).run(["y"], {"x": np.eye(2, dtype=np.float32)})
    np.testing.assert_array_equal(got, WEIGHT)


@pytest.mark.parametrize(
    "location",
    ["../secret.bin", "parts/../../secret.bin", "/etc/passwd", "", "*/_ORT_MEM_ADDR_/*", "weight.bin\\..\\secret.bin"],
)
def test_data_elsewhere_are_refused(folder: Path, location: str) -> None:
    path = written(folder / "a.onnx", network(external(location)))
    with pytest.raises(ModelFileError, match=r"outside its folder|are missing"):
        session(path, 1)


def test_absolute_and_climbing_paths_are_refused_even_where_the_file_is(folder: Path) -> None:
    for location in (str(folder / "weight.bin"), "../net/weight.bin"):
        with pytest.raises(ModelFileError, match="outside its folder"):
            session(written(folder / "a.onnx", network(external(location))), 1)


def test_links_to_data_are_refused(folder: Path) -> None:
    (folder / "link.bin").symlink_to(folder.parent / "secret.bin")
    (folder / "up").symlink_to(folder.parent)
    for location in ("link.bin", "up/secret.bin"):
        with pytest.raises(ModelFileError, match="not a link"):
            session(written(folder / "a.onnx", network(external(location))), 1)


def test_data_of_inner_graphs_and_attributes_are_looked_at(folder: Path) -> None:
    constant = helper.make_node("Constant", [], ["y"], value=external("../secret.bin"))
    inner = helper.make_graph([constant], "inner", [], [helper.make_tensor_value_info("y", TensorProto.FLOAT, [2, 3])])
    nodes = [
        helper.make_node("Constant", [], ["yes"], value=numpy_helper.from_array(np.array(True))),
        helper.make_node("If", ["yes"], ["z"], then_branch=inner, else_branch=inner),
    ]
    graph = helper.make_graph(nodes, "outer", [], [helper.make_tensor_value_info("z", TensorProto.FLOAT, [2, 3])])
    with pytest.raises(ModelFileError, match="outside its folder"):
        session(written(folder / "a.onnx", helper.make_model(graph)), 1)
    function = helper.make_function("own", "F", [], ["y"], [constant], [helper.make_opsetid("", 17)])
    model = network()
    model.functions.append(function)
    with pytest.raises(ModelFileError, match="outside its folder"):
        session(written(folder / "b.onnx", model), 1)


@pytest.mark.parametrize(
    "tensor",
    [
        external("weight.bin", (2, 3000)),
        external("weight.bin", (1 << 40, 1 << 40)),
        external("weight.bin", offset="4"),
        external("weight.bin", offset="1000000"),
        external("weight.bin", length="20"),
        TensorProto(name="weight", dims=(1 << 40, 3), data_type=TensorProto.FLOAT, raw_data=WEIGHT.tobytes()),
        TensorProto(name="weight", dims=(2, 3), data_type=TensorProto.FLOAT, raw_data=WEIGHT.tobytes()[:-4]),
        TensorProto(name="weight", dims=(2, 3), data_type=TensorProto.FLOAT, float_data=[1.0] * 5),
        TensorProto(name="weight", dims=(2, 3), data_type=TensorProto.INT4, int32_data=[1, 1]),
        TensorProto(name="weight", dims=(2, 3), data_type=TensorProto.COMPLEX64, float_data=[1.0] * 11),
    ],
)
def test_constants_larger_than_their_data_are_refused(folder: Path, tensor: TensorProto) -> None:
    with pytest.raises(ModelFileError, match="declares more than its data"):
        session(written(folder / "a.onnx", network(tensor)), 1)


@pytest.mark.parametrize(
    "tensor",
    [
        external("weight.bin", offset="-8"),
        external("weight.bin", length="many"),
        TensorProto(name="weight", dims=(-2, -3), data_type=TensorProto.FLOAT, raw_data=WEIGHT.tobytes()),
        TensorProto(name="weight", dims=(2, 3), data_type=99, raw_data=WEIGHT.tobytes()),
    ],
)
def test_malformed_constants_are_refused(folder: Path, tensor: TensorProto) -> None:
    with pytest.raises(ModelFileError, match="malformed"):
        session(written(folder / "a.onnx", network(tensor)), 1)


@pytest.mark.parametrize(
    "tensor",
    [
        numpy_helper.from_array(WEIGHT.astype(np.float16), "weight"),
        numpy_helper.from_array(np.array(["a", "b"], object), "weight"),
        TensorProto(name="weight", dims=(2, 3), data_type=TensorProto.INT4, raw_data=b"123"),
        TensorProto(name="weight", dims=(), data_type=TensorProto.INT64, int64_data=[3]),
        TensorProto(name="weight", dims=(0, 3), data_type=TensorProto.FLOAT),
    ],
)
def test_every_way_to_hold_a_constant_is_counted_right(tmp_path: Path, tensor: TensorProto) -> None:
    inspect(written(tmp_path / "a.onnx", network(tensor)))


def test_sparse_constants_are_refused(folder: Path) -> None:
    model = network()
    values = numpy_helper.from_array(np.ones(1, np.float32), "big")
    places = numpy_helper.from_array(np.zeros(1, np.int64))
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(values, places, [1 << 20, 1 << 20]))
    with pytest.raises(ModelFileError, match="sparse"):
        session(written(folder / "a.onnx", model), 1)


def test_operators_of_others_are_named(folder: Path) -> None:
    with pytest.raises(ModelFileError, match=r"evil\.corp\.Run"):
        session(written(folder / "a.onnx", network(op="Run", domain="evil.corp")), 1)


def _cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


@pytest.mark.parametrize(
    "spoilt",
    [
        _cut,
        lambda _: b"",
        lambda _: b"not a network at all",
        lambda _: bytes(1000),
        lambda c: b"\x00\x00\x00\x00ORTM" + c,
    ],
)
def test_other_bytes_are_no_network(folder: Path, spoilt: Callable[[bytes], bytes]) -> None:
    path = folder / "a.onnx"
    path.write_bytes(spoilt(network().SerializeToString()))
    with pytest.raises(ModelFileError, match="not a usable ONNX network"):
        session(path, 1)


def test_what_onnxruntime_refuses_is_named_too(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="not a usable ONNX network"):
        session(written(tmp_path / "a.onnx", network(op="NoSuchOperator")), 1)


def test_a_file_larger_than_a_protocol_buffer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.onnx", network())
    monkeypatch.setattr(onnx_file, "LIMIT", path.stat().st_size - 1)
    with pytest.raises(ModelFileError, match=r"larger than .*(\n.*)*external data"):
        inspect(path)


def test_a_sparse_file_of_five_gigabytes_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.onnx"
    with path.open("wb") as stream:
        stream.truncate(5 << 30)
    with pytest.raises(ModelFileError, match="larger than"):
        inspect(path)


@pytest.mark.parametrize("path", sorted(DATA.glob("*.onnx")), ids=lambda path: path.name)
def test_our_own_networks_pass(path: Path) -> None:
    assert inspect(path).inputs


def test_signatures_are_compared_by_name_or_in_order(tmp_path: Path) -> None:
    path = written(tmp_path / "a.onnx", network())
    ports = inspect(path)
    compare(path, Signature({"x": (None, 2)}, {"y": (None, 3)}), ports)
    compare(path, Signature({"image": (ANY, 2)}, {"out": (ANY, ANY)}, any_names=True), ports)
    for wrong in (
        Signature({"image": (ANY, 2)}, {"y": (None, 3)}),
        Signature({"x": (None, 4)}, {"y": (None, 3)}, any_names=True),
        Signature({"x": (None, 2)}, {"y": (None, 3), "z": (None,)}, any_names=True),
    ):
        with pytest.raises(ModelFileError, match=r"has other (in|out)puts"):
            compare(path, wrong, ports)
        with pytest.raises(ModelFileError, match=r"has other (in|out)puts"):
            session(path, 1, wrong)
