"""The perceiver of the image tokens against its formulas, written out."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from soar.priors.imagedream.resampler import Resampler
from tests.priors.imagedream.small import filled, wave

FEATURES, WIDTH, TOKENS, DEPTH, HEADS, HEAD = 10, 24, 5, 2, 3, 4  # what the heads see is not as wide as a token
INNER = HEADS * HEAD


@pytest.fixture(scope="module")
def network() -> Resampler:
    return filled(Resampler(FEATURES, WIDTH, TOKENS, DEPTH, HEADS, HEAD)).double()


def features(pictures: int, length: int = 9) -> Tensor:
    return 3 * wave(0.61, 0.2, pictures, length, FEATURES).double()


def normalised(x: Tensor, state: Mapping[str, Tensor], name: str) -> Tensor:
    middle = x - x.mean(-1, keepdim=True)
    spread = (middle.square().mean(-1, keepdim=True) + 1e-5).sqrt()
    return middle / spread * state[f"{name}.weight"] + state[f"{name}.bias"]


def tokens_of(picture: Tensor, state: Mapping[str, Tensor]) -> Tensor:
    """(L, F) features of one picture to (T, D) tokens."""
    seen = picture @ state["proj_in.weight"].T + state["proj_in.bias"]
    latents = state["latents"][0]
    for layer in range(DEPTH):
        name = f"layers.{layer}.0"
        asking = normalised(latents, state, f"{name}.norm2")
        asked = torch.cat([normalised(seen, state, f"{name}.norm1"), asking])
        query = asking @ state[f"{name}.to_q.weight"].T
        both = asked @ state[f"{name}.to_kv.weight"].T
        key, value = both[:, :INNER], both[:, INNER:]
        answers = []
        for head in range(HEADS):
            part = slice(head * HEAD, (head + 1) * HEAD)
            likeness = (query[:, part] @ key[:, part].T / math.sqrt(HEAD)).exp()
            answers.append(likeness / likeness.sum(1, keepdim=True) @ value[:, part])
        latents = latents + torch.cat(answers, 1) @ state[f"{name}.to_out.weight"].T
        name = f"layers.{layer}.1"
        inner = normalised(latents, state, f"{name}.0") @ state[f"{name}.1.weight"].T
        gelu = inner * (1 + torch.erf(inner / math.sqrt(2))) / 2
        latents = latents + gelu @ state[f"{name}.3.weight"].T
    return normalised(latents @ state["proj_out.weight"].T + state["proj_out.bias"], state, "norm_out")


def test_tokens_equal_the_formulas(network: Resampler) -> None:
    given = features(3)
    expected = torch.stack([tokens_of(picture, network.state_dict()) for picture in given])
    assert expected.std() > 0.5
    torch.testing.assert_close(network(given), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("pictures", "length"), [(1, 257), (4, 257), (2, 1)])
def test_any_number_of_pictures_and_features_gives_the_same_number_of_tokens(
    network: Resampler, pictures: int, length: int
) -> None:
    given = features(pictures, length)
    tokens = network(given)
    assert tokens.shape == (pictures, TOKENS, WIDTH)
    torch.testing.assert_close(tokens[-1:], network(given[-1:]), rtol=0, atol=1e-12)  # no picture sees another


def test_keys_and_shapes_are_the_released_ones_names() -> None:
    layer = {
        "0.norm1.weight": (WIDTH,), "0.norm1.bias": (WIDTH,), "0.norm2.weight": (WIDTH,), "0.norm2.bias": (WIDTH,),
        "0.to_q.weight": (INNER, WIDTH), "0.to_kv.weight": (2 * INNER, WIDTH), "0.to_out.weight": (WIDTH, INNER),
        "1.0.weight": (WIDTH,), "1.0.bias": (WIDTH,), "1.1.weight": (4 * WIDTH, WIDTH),
        "1.3.weight": (WIDTH, 4 * WIDTH),
    }  # fmt: skip
    expected = {
        "latents": (1, TOKENS, WIDTH), "proj_in.weight": (WIDTH, FEATURES), "proj_in.bias": (WIDTH,),
        "proj_out.weight": (WIDTH, WIDTH), "proj_out.bias": (WIDTH,), "norm_out.weight": (WIDTH,),
        "norm_out.bias": (WIDTH,),
    }  # fmt: skip
    expected |= {f"layers.{number}.{key}": shape for number in range(DEPTH) for key, shape in layer.items()}
    made = Resampler(FEATURES, WIDTH, TOKENS, DEPTH, HEADS, HEAD)
    assert {key: tuple(value.shape) for key, value in made.state_dict().items()} == expected
