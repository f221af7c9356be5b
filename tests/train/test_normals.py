"""The task `normals`: loss, sheet, a short training, evaluation, and the configuration that ships."""

import numpy as np
import pytest
import torch

from soar.artifacts import read_json
from soar.models.onnx import session
from soar.networks.normal_inputs import INPUTS, SIGNATURE
from soar.train.evaluate_normals import angles, table
from soar.train.normal_samples import Sample
from soar.train.normals import NormalTask, degrees, mean_over
from soar.train.registry import TASKS, training
from soar.workflow import CONF, composed
from tests.conftest import model_file


def shipped(*overrides):
    return composed(("+train=normals", *overrides))["train"]


def short(*overrides):
    """A configuration of moments."""
    return shipped(
        "train.steps=3", "train.minutes=null", "train.workers=0", "train.device=cpu", "train.record_every=1",
        "train.validate_every=3", "train.validation_batches=1", "train.network={widths: [8, 16], depths: [1, 1]}",
        "train.samples.sizes=[[32, 32]]", "train.samples.pixels=2048", "train.evaluation.count=3",
        "train.evaluation.size=[40, 32]", *overrides,
    )  # fmt: skip


@pytest.fixture(scope="module")
def models():
    return model_file("body/anny_helpers.npz").parents[1]


def test_every_configuration_has_a_task():
    assert set(TASKS) == {path.stem for path in (CONF / "train").glob("*.yaml")}


def test_loss_of_known_angles():
    task = NormalTask.__new__(NormalTask)  # the loss needs no samples
    east, toward = torch.tensor([1.0, 0, 0]), torch.tensor([0, 0, -1.0])
    plane = lambda vector: vector[None, :, None, None].expand(1, 3, 2, 2)  # noqa: E731
    batch = {name: torch.zeros(1, count, 2, 2) for name, count in INPUTS.items()}
    batch |= {"T_normal_F": plane(east), "T_normal_B": plane(-toward), "nml_F": plane(toward), "nml_B": plane(-toward)}
    batch["weight"] = torch.tensor([[[[1.0, 0], [0, 1]]]])
    halfway = torch.nn.functional.normalize(east + toward, dim=0)

    def network(*inputs):
        assert [value.shape[1] for value in inputs] == list(INPUTS.values())
        return plane(halfway), plane(toward)

    loss, figures = task.loss(network, batch)
    assert float(loss) == pytest.approx(1 - 0.5**0.5 + 2, abs=1e-5)
    assert float(figures["front"]) == pytest.approx(45, abs=0.01)
    assert float(figures["body_front"]) == pytest.approx(90, abs=0.01)
    assert float(figures["back"]) == pytest.approx(180, abs=0.1)
    assert float(figures["body_back"]) == pytest.approx(0, abs=0.1)


def test_unweighted_pixels_do_not_count():
    value, weight = torch.rand(1, 1, 4, 4), torch.zeros(1, 1, 4, 4)
    assert mean_over(value, weight) == 0
    weight[..., 0, 0] = 1
    assert mean_over(value, weight) == value[..., 0, 0]
    assert degrees(torch.tensor(1.5)) == 0


def test_a_short_training_end_to_end(models, tmp_path, capsys):
    training("normals", short(), models, tmp_path).run()
    session(tmp_path / "network.onnx", 1, SIGNATURE)
    record = read_json(tmp_path / "records/network.onnx.json")
    assert record["training"]["steps"] == 3
    assert record["training"]["config"]["samples"]["pixels"] == 2048
    assert {"front", "body_front", "back", "body_back"} <= set(record["validation"])
    assert (tmp_path / "sheet.jpg").exists()
    assert read_json(tmp_path / "curve.json")[0]["body_front"] > 3
    task = NormalTask(
        {k: v for k, v in short().items() if k in ("network", "samples", "synthetic", "evaluation")}, models
    )
    capsys.readouterr()
    task.evaluate(tmp_path / "network.onnx", tmp_path, 1)
    result = read_json(tmp_path / "evaluation.json")
    assert list(result) == ["0", "1", "2"]
    bodies = [result[amount]["all"]["front_body"] for amount in result]
    assert bodies == sorted(bodies)
    assert result["1"]["all"]["count"] == 3
    assert capsys.readouterr().out == table(result) + "\n"


def test_resumed_training_gives_the_same_bits(models, tmp_path):
    training("normals", short(), models, tmp_path / "whole").run()
    training("normals", short("train.steps=1"), models, tmp_path / "parts")  # another length is no other training
    first = training("normals", short("train.save_seconds=0"), models, tmp_path / "parts")
    first.settings = type(first.settings)(**{**vars(first.settings), "save_seconds": 0.0})
    batches = first._batches("train", range(2), 0)
    for batch in batches:
        first._descend(batch)
    first._save()
    second = training("normals", short(), models, tmp_path / "parts")
    assert second.step == 2
    second.run()
    whole = torch.load(tmp_path / "whole/state.pt", weights_only=True)["state"]
    parts = torch.load(tmp_path / "parts/state.pt", weights_only=True)["state"]
    for name, value in whole["averaged"].items():
        assert torch.equal(value, parts["averaged"][name])


def test_angles_of_a_known_picture():
    normal = np.zeros((4, 4, 3), np.float32)
    normal[..., 2] = -1
    tilted = np.zeros_like(normal)
    tilted[..., 0], tilted[..., 2] = 0.6, -0.8
    body = tilted.copy()
    body[:, 2:] = 0  # the body covers half
    full = np.full((4, 4), 255, np.uint8)
    sample = Sample(np.zeros((4, 4, 3), np.uint8), full, body, -body, normal, -normal, full / 255.0, ("top tee",))
    got = angles(lambda *inputs: (normal, -tilted), sample)
    tilt = np.rad2deg(np.arccos(0.8))
    assert got["front"] == pytest.approx(0, abs=0.05)
    assert got["front_body"] == pytest.approx(tilt, abs=0.05)
    assert got["back"] == pytest.approx(tilt, abs=0.05)
    assert got["back_where_body"] == pytest.approx(tilt, abs=0.05)
    body[:] = 0
    assert np.isnan(angles(lambda *inputs: (normal, -tilted), sample)["front_body_where_body"])
