"""Progress bars for anything over a few seconds; silent when standard error is not a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")


def track(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Iterate over ``items`` under a bar labelled ``what``."""
    yield from tqdm(items, desc=what, total=total, disable=not sys.stderr.isatty(), leave=False)
