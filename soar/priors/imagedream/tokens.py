"""Words and pictures as the CLIP towers take them."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional as F

from soar.errors import ModelFileError
from soar.models.catalogue import fetch_command
from soar.priors.imagedream.extra import extra

if TYPE_CHECKING:
    from tokenizers import Tokenizer

LENGTH = 77
"""Tokens of a text."""

SIDE = 224
"""Side of the image tower's pictures, pixels."""

_START, _END = "<|startoftext|>", "<|endoftext|>"
_VOCABULARY = 49408
_MEAN = (0.48145466, 0.4578275, 0.40821073)
_DEVIATION = (0.26862954, 0.26130258, 0.27577711)


def tokenizer(path: Path, size: int = _VOCABULARY) -> Tokenizer:
    """CLIP's byte-pair tokeniser.

    Args:
        path: ``clip_vocabulary.txt.gz`` (the list of merges that OpenAI published), or a ``tokenizer.json``.
        size: entries of the vocabulary; those of the list beyond it are left out.

    Raises:
        ModelFileError: the file is missing or holds something else.
    """
    if not path.is_file():
        raise ModelFileError(f"{path} is missing", cure=f"run {fetch_command(path.name)}, or name a file that is there")
    if path.suffix == ".json":
        return extra("tokenizers").Tokenizer.from_file(str(path))
    try:
        lines = gzip.decompress(path.read_bytes()).decode("utf-8").split("\n")
        letters = _letters()
        merges = [tuple(line.split()) for line in lines[1 : size - 2 * len(letters) - 1]]
        words = [*letters, *(letter + "</w>" for letter in letters), *(a + b for a, b in merges), _START, _END]
    except (OSError, EOFError, ValueError) as error:
        raise ModelFileError(f"{path} is not CLIP's vocabulary: {error}") from error
    if len(words) != size:
        raise ModelFileError(f"{path} is not CLIP's vocabulary", expected=f"{size} entries", got=str(len(words)))
    vocabulary = {word: number for number, word in enumerate(words)}
    return extra("transformers").CLIPTokenizer(vocab=vocabulary, merges=merges).backend_tokenizer


def _letters() -> list[str]:
    """A printable letter for every byte: first those that print, as themselves; the others get letters from 256."""
    printing = [*range(ord("!"), ord("~") + 1), *range(ord("¡"), ord("¬") + 1), *range(ord("®"), ord("ÿ") + 1)]
    others = 256 - len(printing)
    return [chr(byte) for byte in printing] + [chr(256 + k) for k in range(others)]


def token_ids(tokens: Tokenizer, texts: Sequence[str]) -> Tensor:
    """(B, 77) int64: start, words, end, zeros; of a text that is too long the beginning."""
    rows = torch.zeros(len(texts), LENGTH, dtype=torch.int64)
    for row, text in zip(rows, texts, strict=True):
        ids = tokens.encode(text).ids
        kept = [*ids[: LENGTH - 1], ids[-1]] if len(ids) > LENGTH else ids
        row[: len(kept)] = torch.tensor(kept)
    return rows


def pixel_values(pictures: Tensor) -> Tensor:
    """Square pictures (B, 3, S, S) in [0, 1] as the image tower takes them, (B, 3, 224, 224)."""
    sized = F.interpolate(pictures, (SIDE, SIDE), mode="bicubic", antialias=True).clamp(0, 1)
    mean, deviation = (sized.new_tensor(values)[:, None, None] for values in (_MEAN, _DEVIATION))
    return (sized - mean) / deviation
