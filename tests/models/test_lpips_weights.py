"""Pickles of plain arrays are read; pickles that would run something are not."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from soar.errors import ModelFileError
from soar.models.lpips_weights import lpips_tensors, unpickle_arrays
from tests.models.test_fetch import lpips_pickle, pickled


def test_layout_becomes_oihw() -> None:
    tree = {"VGG16_0": {"Conv_0": {"kernel": np.arange(24, dtype=np.float32).reshape(2, 3, 1, 4), "bias": np.ones(4)}}}
    tree |= {f"NetLinLayer_{k}": {"Conv_0": {"kernel": np.ones((1, 1, 4, 1))}} for k in range(5)}
    tensors = lpips_tensors(pickled(tree), "test")
    assert tensors["conv0.weight"].shape == (4, 1, 2, 3)
    assert float(tensors["conv0.weight"][2, 0, 1, 1]) == tree["VGG16_0"]["Conv_0"]["kernel"][1, 1, 0, 2]


class _Bomb:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return os.mkdir, (str(self.path),)


def test_code_in_a_pickle_is_refused_and_not_run(tmp_path: Path) -> None:
    content = pickle.dumps({"AlexNet_0": _Bomb(tmp_path / "ran")})
    with pytest.raises(ModelFileError, match="mkdir"):
        unpickle_arrays(content, "bomb")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("keep", [0, 10, 200])
def test_truncated(keep: int) -> None:
    with pytest.raises(ModelFileError, match="not a pickle of plain arrays"):
        unpickle_arrays(lpips_pickle()[:keep], "short")


def test_other_structures_are_named() -> None:
    with pytest.raises(ModelFileError, match="holds a list"):
        unpickle_arrays(pickle.dumps([1, 2]), "list")
    with pytest.raises(ModelFileError, match="lacks"):
        lpips_tensors(pickle.dumps({"ResNet_0": {}}), "other")
