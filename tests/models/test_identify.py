"""What ``python -m soar models check`` says of every form of file and folder, and of what is none."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from onnx import TensorProto, helper

from soar.cli import main
from soar.errors import InputError, ModelFileError
from soar.importers import pose_network
from soar.importers.registry import FORMATS
from soar.models.identify import Form, identify, network, overrides, report
from soar.models.onnx import Signature
from soar.networks import DATA, normal_inputs, prior_inputs
from soar.perception import icon, sapiens
from soar.priors.imagedream.onnx import TOKENS, signatures
from soar.stages._forms import FORMS
from soar.workflow import composed
from tests.body import official
from tests.importers import person, writers
from tests.importers.test_readers import HANDS, MODEL, assumed
from tests.perception import exports
from tests.perception.test_normal_export import shapes, state


def with_signature(path: Path, signature: Signature) -> Path:
    """An ONNX file that says it has a signature; what it computes does not matter here."""
    path.parent.mkdir(parents=True, exist_ok=True)

    def ports(shapes: dict) -> list:
        return [
            helper.make_tensor_value_info(
                name, TensorProto.INT64 if name in signature.integers else TensorProto.FLOAT,
                [f"axis{i}" if size in (None, -1) else size for i, size in enumerate(shape)],
            )
            for name, shape in shapes.items()
        ]  # fmt: skip

    first = next(iter(signature.inputs))
    nodes = [helper.make_node("Identity", [first], [name]) for name in signature.outputs]
    graph = helper.make_graph(nodes, "net", ports(signature.inputs), ports(signature.outputs))
    path.write_bytes(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)]).SerializeToString())
    return path


def fits(path: Path) -> list[str]:
    """Names of the forms that a path fits."""
    return [finding.form.name for finding in identify(path, FORMS) if finding.error is None]


@pytest.mark.parametrize("kind", FORMATS)
def test_body_parameters_are_told_apart(tmp_path: Path, kind: str) -> None:
    what = person.truth(3, 4.0)
    more = {"pelvis": np.asarray(MODEL.J_template[0])} if kind == "easymocap" else {}
    path = writers.WRITERS[kind](tmp_path / kind, what, assumed(kind), HANDS, **more)
    assert fits(path) == [f"body parameters of {kind}"]


@pytest.mark.parametrize(
    ("name", "signature"),
    [
        (
            "whole-body network with SimCC heads, as RTMW, RTMPose and DWPose",
            Signature({"input": (None, 3, 384, 288)}, {"simcc_x": (None, 133, 576), "simcc_y": (None, 133, 768)}),
        ),
        ("YOLOX, which finds people", Signature({"images": (1, 3, 640, 640)}, {"output": (1, 8400, 85)})),
        ("YOLOX, which finds people", Signature({"x": (1, 3, 416, 416)}, {"dets": (1, None, 5), "labels": (1, None)})),
        ("normal network of the bundled kind", normal_inputs.SIGNATURE),
        ("normal network of Sapiens", sapiens.SIGNATURE),
        ("prior of the bundled kind", prior_inputs.signature(64)),
        ("network that estimates SMPL-X's parameters", pose_network.SIGNATURE),
    ],
)
def test_networks_of_one_file(tmp_path: Path, name: str, signature: Signature) -> None:
    assert fits(with_signature(tmp_path / "n.onnx", signature)) == [name]


@pytest.mark.parametrize(
    ("name", "contract", "besides"),
    [
        ("normal networks of ICON or ECON", icon.SIGNATURES, ()),
        ("prior ImageDream, exported in the mode pixel", signatures("pixel"), (TOKENS,)),
        ("prior ImageDream, exported in the mode local", signatures("local"), (TOKENS,)),
    ],
)
def test_folders_of_networks(tmp_path: Path, name: str, contract: dict, besides: tuple[str, ...]) -> None:
    for file, signature in contract.items():
        with_signature(tmp_path / f"{file}.onnx", signature)
    for file in besides:
        (tmp_path / file).write_text("{}")
    assert fits(tmp_path) == [name]
    last = list(contract)[-1]
    (tmp_path / f"{last}.onnx").unlink()
    assert fits(tmp_path) == []
    with pytest.raises(ModelFileError, match=rf"not {re.escape(name)}: lacks {last}\.onnx"):
        report(tmp_path, FORMS)


@pytest.mark.parametrize("kind", ["sam", "sam_own", "sam2", "sam2_runtime"])
def test_halves_of_segment_anything(tmp_path: Path, kind: str) -> None:
    pair = exports.sam_pair(tmp_path, kind)
    family = {"sam2": "SAM 2 of samexporter", "sam2_runtime": "SAM 2 of onnxruntime"}.get(kind, "SAM, MobileSAM")
    for half, path in pair.items():
        found = fits(path)
        assert f"{half} of {family}" in found
        # These files do not tell how many channels they give, so that they may be masks.
        assert half == "encoder" or len(found) == 1
        assert all(name == f"{half} of {family}" or name.startswith("mask network") for name in found)


@pytest.mark.parametrize("option", ["u2net", "modnet", "pp_humanseg"])
def test_mask_networks_by_their_description(tmp_path: Path, option: str) -> None:
    path = exports.finder(exports.masks_node(option), tmp_path / "n.onnx", ("in", "out"))
    assert f"mask network of the kind {option}" in fits(path)
    assert all(name.startswith("mask network") for name in fits(path))


def test_robust_video_matting(tmp_path: Path) -> None:
    path = exports.video_finder(exports.masks_node("rvm"), tmp_path / "n.onnx")
    assert fits(path) == ["mask network of the kind rvm"]


def test_the_model_file_of_smplx(tmp_path: Path) -> None:
    path = official.write(tmp_path / "SMPLX_NEUTRAL.npz", official.arrays(20, dtype=np.float32))
    assert fits(path) == ["model file of SMPL-X"]
    assert "version 1.0, 10 shape components" in report(path, FORMS)


def test_a_checkpoint_of_icon(tmp_path: Path) -> None:
    path = tmp_path / "normal.ckpt"
    # Expanded tensors take no room.
    torch.save({"state_dict": {key: torch.zeros(1).expand(shape) for key, shape in shapes(64).items()}}, path)
    assert fits(path) == ["checkpoint of the normal networks of ICON or ECON"]
    assert f"python -m soar export-normals {path}" in report(path, FORMS)
    torch.save({"state_dict": state(2)}, path)
    with pytest.raises(ModelFileError, match=r"not checkpoint of the normal networks(.*\n)*.*generator of 64 channels"):
        report(path, FORMS)


def picture(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), values)


def test_folders_of_pictures(tmp_path: Path) -> None:
    grey = np.zeros((8, 8), np.uint8)
    grey[2:6, 2:6] = 255
    violet = np.full((8, 8, 3), (255, 128, 128), np.uint8)  # blue, green, red: a surface that faces the camera
    for frame in range(3):
        picture(tmp_path / "masks" / f"{frame:04d}.png", grey)
        picture(tmp_path / "normals" / f"{frame:04d}.png", violet)
        picture(tmp_path / "cut_outs" / f"{frame:04d}.png", np.dstack([0 * violet, grey]))
        picture(tmp_path / "footage" / f"{frame:04d}.jpg", violet)
    assert fits(tmp_path / "masks") == ["masks"]
    assert "3 masks, numbered 0 to 2, white where the person is" in report(tmp_path / "masks", FORMS)
    assert fits(tmp_path / "normals") == ["normal maps"]
    assert fits(tmp_path / "cut_outs") == ["masks"]
    assert "masks.plane=alpha" in report(tmp_path / "cut_outs", FORMS)
    assert fits(tmp_path / "footage") == []


def test_keypoints_of_openpose(tmp_path: Path) -> None:
    person = {"pose_keypoints_2d": [10.0, 20.0, 0.9] * 25}
    for frame, people in enumerate(([person], [], [person, person])):
        content = json.dumps({"version": 1.3, "people": people})
        (tmp_path / f"clip_{frame:012d}_keypoints.json").write_text(content)
    assert fits(tmp_path) == ["keypoints of OpenPose"]
    assert "3 frames, numbered 0 to 2, with up to 2 people" in report(tmp_path, FORMS)
    (tmp_path / "clip_000000000001_keypoints.json").write_text('{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}')
    with pytest.raises(ModelFileError, match=r"not keypoints of OpenPose: .*3 numbers"):
        report(tmp_path, FORMS)


def test_files_of_the_project(tmp_path: Path) -> None:
    for path in DATA.glob("*.onnx"):
        assert "model file of the project's own, which needs no setting" in fits(path)
    altered = tmp_path / "normals.onnx"
    altered.write_bytes((DATA / "normals.onnx").read_bytes())
    assert fits(altered) == ["normal network of the bundled kind"]  # without its record it is somebody's


def test_every_command_composes() -> None:
    """What is printed can be typed: options and fields exist. Commands of different groups are composed together."""
    groups: dict[str, dict[tuple[str, ...], list[str]]] = {}
    for form in FORMS:
        if found := re.fullmatch(r"snakemake --config 'overrides=(\[.*\])'", form.use):
            settings = [setting.replace("=...", "=c") for setting in json.loads(found[1])]
            chosen = tuple(setting for setting in settings if "." not in setting.split("=")[0])
            if form.name.startswith("mask network"):
                chosen = ("masks=u2net",)  # one stands for all: they are described by the same fields
            groups.setdefault(settings[0].split("=")[0].split(".")[0], {})[chosen] = settings
    assert len(groups) == 5
    for together in itertools.zip_longest(*(commands.values() for commands in groups.values()), fillvalue=[]):
        settings = [setting.replace("PATH", f"a/{i}.onnx") for i, part in enumerate(together) for setting in part]
        config = json.dumps(composed(tuple(sorted(settings, key=lambda setting: "." in setting.split("=")[0]))))
        assert all((f"a/{i}.onnx" in config) == bool(part) for i, part in enumerate(together))


def test_what_fits_nothing_is_compared_with_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = with_signature(tmp_path / "n.onnx", Signature({"x": (1, 7)}, {"y": (1, 7)}))
    assert main(["models", "check", str(path)]) == 2
    said = capsys.readouterr().err
    assert "takes x (1, 7) float" in said
    assert "not normal network of Sapiens: has other inputs" in said
    assert "expected: * (any, 3, 1024, 768) float32" in said
    assert "not decoder of SAM, MobileSAM" in said
    assert "mask_input" in said


def test_what_fits_is_used_by_the_line_that_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = with_signature(tmp_path / "n.onnx", sapiens.SIGNATURE)
    assert main(["models", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"""snakemake --config 'overrides=["normals=sapiens","normals.network={path}"]'""" in said


def test_paths_that_are_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for content, name in ((b"", "n.onnx"), (b"no network", "m.onnx"), (b"\x80\x04garbage", "a.pkl"), (b"PK", "b.npz")):
        (tmp_path / name).write_bytes(content)
        assert main(["models", "check", str(tmp_path / name)]) == 2
    assert "not a usable ONNX network" in capsys.readouterr().err
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "notes.txt", tmp_path / "empty", tmp_path / "nowhere"):
        assert main(["models", "check", str(path)]) == 2
    assert "is not there" in capsys.readouterr().err
    for wrong in (["models", "check"], ["models", "list", "x"]):
        assert main(wrong) == 2
    with pytest.raises(InputError, match="is not there"):
        identify(tmp_path / "nowhere", FORMS)


class Bomb:
    def __reduce__(self) -> tuple:
        return (Path.touch, (Path("exploded"),))


def test_nothing_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pickle

    monkeypatch.chdir(tmp_path)
    for name in ("a.pkl", "a.pt", "a.pth", "a.ckpt"):
        Path(name).write_bytes(pickle.dumps({"v_template": Bomb()}, protocol=2))
    torch.save({"state_dict": Bomb()}, "b.pt")
    np.savez("a.npz", v_template=np.array([Bomb()], object))
    (tmp_path / "maps").mkdir()
    np.save("maps/0.npy", np.array([Bomb()], object), allow_pickle=True)
    for name in ("a.pkl", "a.pt", "a.pth", "a.ckpt", "b.pt", "a.npz", "maps"):
        assert main(["models", "check", name]) == 2
    assert not Path("exploded").exists()


def test_a_form_of_ones_own(tmp_path: Path) -> None:
    own = Form("note", overrides("caption.text=PATH"), (".txt",), lambda path: path.read_text())
    sapiens_like = network("like Sapiens", overrides("a=PATH"), sapiens.SIGNATURE)
    (tmp_path / "a.TXT").write_text("two words")
    said = report(tmp_path / "a.TXT", [own, sapiens_like])
    assert said.splitlines()[1:] == [
        "  fits: note (two words)",
        f"        snakemake --config 'overrides=[\"caption.text={tmp_path / 'a.TXT'}\"]'",
    ]
