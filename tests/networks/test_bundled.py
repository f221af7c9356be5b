"""The networks that come with the package do what their cards say, on a few people they never met."""

import pytest

from soar.artifacts import read_json
from soar.perception.normal_network import BUNDLED, NormalEstimator
from soar.train.evaluate_normals import NormalEvaluationSettings, evaluate
from soar.train.registry import task
from soar.workflow import composed
from tests.conftest import model_file


def test_records_name_the_files_and_what_made_them():
    record = read_json(BUNDLED.parent / "records" / f"{BUNDLED.name}.json")
    assert record["file"] == BUNDLED.name
    assert record["bytes"] == BUNDLED.stat().st_size <= 10_000_000
    assert record["licence"] == "Apache-2.0"
    assert record["difference_to_torch"] <= 1e-3
    assert record["training"]["samples"] > 5000
    assert record["training"]["config"]["task"] == "normals"


@pytest.mark.parametrize("amount", [0.0, 1.0])
def test_normals_are_nearer_to_the_truth_than_the_bodys(amount):
    models = model_file("body/anny_helpers.npz").parents[1]
    samples = task("normals", composed(("+train=normals",))["train"], models).samples
    options = NormalEvaluationSettings(seed=2, count=6, size=(160, 128), amounts=(amount,), mirror=False)
    figures = evaluate(NormalEstimator(None, 16, False, 1), samples, options)[f"{amount:g}"]["all"]
    share = {0.0: 0.95, 1.0: 0.7}[amount]
    for side in ("front", "back"):
        assert figures[side] < share * figures[f"{side}_body"]
