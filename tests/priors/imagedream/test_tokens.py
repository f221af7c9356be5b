"""Texts are split as OpenCLIP splits them, pictures scaled as its towers expect."""

import gzip

import pytest
import torch

from soar.errors import ConfigError, ModelFileError
from soar.priors.imagedream import extra
from soar.priors.imagedream.prior import VOCABULARY
from soar.priors.imagedream.tokens import pixel_values, token_ids, tokenizer
from tests.conftest import model_file
from tests.priors.imagedream.small import wave

# What OpenCLIP's own tokeniser gives.
KNOWN = {
    "A man with a black T-shirt, black pants, and black shoes with red soles.": [
        49406, 320, 786, 593, 320, 1449, 339, 268, 2523, 267, 1449, 5003, 267, 537, 1449, 4079, 593, 736, 22682, 269,
        49407,
    ],
    "  Eine Frau   in grünem Kleid, it's 3 o'clock & 42 naïve cafés — ☃!": [
        49406, 68, 715, 3368, 340, 530, 709, 6522, 45153, 7612, 1014, 267, 585, 568, 274, 334, 262, 6716, 261, 275, 273,
        1097, 35689, 563, 3471, 20507, 2005, 38972, 256, 49407,
    ],
    "": [49406, 49407],
}  # fmt: skip
LETTERS = 2 * 256  # entries of single bytes, within words and at their end


def test_known_texts():
    pytest.importorskip("transformers", reason="the optional extra imagedream is not installed")
    tokens = tokenizer(model_file(VOCABULARY))
    rows = token_ids(tokens, list(KNOWN))
    assert rows.shape == (3, 77)
    assert rows.dtype == torch.int64
    for row, ids in zip(rows.tolist(), KNOWN.values(), strict=True):
        assert row == ids + [0] * (77 - len(ids))


@pytest.fixture
def vocabulary(tmp_path):
    """One of two merges: `r e` and `re d</w>`; what follows is not of the vocabulary."""
    path = tmp_path / VOCABULARY
    path.write_bytes(gzip.compress(b"#version\nr e\nre d</w>\na b\n"))
    return path


def test_small_vocabulary_and_its_export(vocabulary, tmp_path):
    pytest.importorskip("transformers", reason="the optional extra imagedream is not installed")
    made = tokenizer(vocabulary, LETTERS + 4)
    letter = {chr(byte): number for number, byte in enumerate(range(ord("!"), ord("~") + 1))}
    start, end = LETTERS + 2, LETTERS + 3
    expected = [start, LETTERS + 1, LETTERS, 256 + letter["a"], end]
    made.save(str(tmp_path / "tokenizer.json"))
    for tokens in (made, tokenizer(tmp_path / "tokenizer.json")):
        (row,) = token_ids(tokens, ["Red  REA"]).tolist()
        assert row == expected + [0] * 72
        (long,) = token_ids(tokens, ["red " * 100]).tolist()
        assert long == [start, *[LETTERS + 1] * 75, end]


def test_files_that_are_no_vocabulary(tmp_path, vocabulary):
    with pytest.raises(ModelFileError, match="is missing") as caught:
        tokenizer(tmp_path / "none" / VOCABULARY)
    assert "--with clip_vocabulary" in caught.value.cure
    with pytest.raises(ModelFileError, match="not CLIP's vocabulary"):
        tokenizer(vocabulary)  # too short
    vocabulary.write_bytes(b"plain text")
    with pytest.raises(ModelFileError, match="not CLIP's vocabulary"):
        tokenizer(vocabulary, LETTERS + 4)


def test_missing_package_names_the_extra():
    with pytest.raises(ConfigError, match="needs the package no_such_package") as caught:
        extra.extra("no_such_package")
    assert "soar-avatar[imagedream]" in caught.value.cure


def test_pictures_are_normalised():
    grey = pixel_values(torch.full((1, 3, 256, 256), 0.5))
    assert grey.shape == (1, 3, 224, 224)
    expected = [
        (0.5 - mean) / deviation
        for mean, deviation in zip(
            (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711), strict=True
        )
    ]
    torch.testing.assert_close(grey.mean((0, 2, 3)), torch.tensor(expected))
    same = wave(0.3, 0, 2, 3, 224, 224).abs()
    deviations = torch.tensor([0.26862954, 0.26130258, 0.27577711])[:, None, None]
    torch.testing.assert_close(
        pixel_values(same) * deviations, same - torch.tensor([0.48145466, 0.4578275, 0.40821073])[:, None, None],
        atol=1e-5, rtol=0,
    )  # fmt: skip
