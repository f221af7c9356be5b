"""The networks that come with the package do what their cards say, on a few people they never met."""

import pytest

from soar.artifacts import read_json
from soar.losses.lpips import Lpips
from soar.networks import DATA
from soar.perception.normal_network import NormalEstimator
from soar.priors.mini import MiniPrior
from soar.train.evaluate_normals import NormalEvaluationSettings, evaluate
from soar.train.evaluate_prior import Parts, PriorEvaluationSettings
from soar.train.evaluate_prior import evaluate as evaluate_prior
from soar.train.registry import task
from soar.workflow import composed
from tests.conftest import model_file


@pytest.mark.parametrize(("name", "most"), [("normals", 10_000_000), ("prior", 40_000_000)])
def test_records_name_the_files_and_what_made_them(name, most):
    record = read_json(DATA / "records" / f"{name}.onnx.json")
    assert record["file"] == f"{name}.onnx"
    assert record["bytes"] == (DATA / f"{name}.onnx").stat().st_size <= most
    assert record["licence"] == "Apache-2.0"
    assert record["difference_to_torch"] <= 1e-3
    assert record["training"]["samples"] > 5000
    assert record["training"]["config"]["task"] == name


def test_direct_guess_of_the_prior_beats_copying():
    model_file("body/anny_helpers.npz")
    models = model_file("lpips_alex.safetensors").parent
    samples = task("prior", composed(("+train=prior",))["train"], models).samples
    prior, options = MiniPrior(None, samples.settings.size, 1), PriorEvaluationSettings(0, 4, (), (), 1)
    lpips = Lpips.load(models / "lpips_alex.safetensors", "alex")
    methods = evaluate_prior(prior, samples, Parts.of(samples.people.wardrobe.body), lpips, options)["methods"]
    back = {name: sum(rows["back_db"]) / len(rows["back_db"]) for name, rows in methods.items()}
    assert back["direct"] > max(back["part mean"], back["mirrored"], back["nearest"])


@pytest.mark.parametrize("amount", [0.0, 1.0])
def test_normals_are_nearer_to_the_truth_than_the_bodys(amount):
    models = model_file("body/anny_helpers.npz").parents[1]
    samples = task("normals", composed(("+train=normals",))["train"], models).samples
    options = NormalEvaluationSettings(seed=2, count=6, size=(160, 128), amounts=(amount,), mirror=False)
    figures = evaluate(NormalEstimator(None, 16, False, 1), samples, options)[f"{amount:g}"]["all"]
    share = {0.0: 0.95, 1.0: 0.7}[amount]
    for side in ("front", "back"):
        assert figures[side] < share * figures[f"{side}_body"]
