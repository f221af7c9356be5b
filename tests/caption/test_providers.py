"""Which provider is chosen, and the user's own words."""

from __future__ import annotations

from typing import Any

import pytest

from soar.caption.records import Footage
from soar.caption.registry import caption_provider
from soar.errors import ConfigError
from soar.raster import RasterSettings
from tests.caption import people
from tests.conftest import conf

RASTER = RasterSettings(1 / 12, True, True, "auto")


def says(text: Any) -> str:
    footage = Footage("someone", people.body(), ())
    return caption_provider(conf("caption", "text") | {"text": text}, RASTER).caption(footage).text


def test_the_users_words() -> None:
    assert says("  A man \n in red. ") == "A man in red."
    assert says({"someone": "A man in red.", "other": "A cat."}) == "A man in red."


@pytest.mark.parametrize("text", ["", " \n ", {}, {"other": "A cat."}, {"someone": ""}])
def test_no_words(text: Any) -> None:
    with pytest.raises(ConfigError, match="someone") as caught:
        says(text)
    assert "caption.text=" in caught.value.cure


@pytest.mark.parametrize("change", [{"provider": "oracle"}, {"frames": 0}, {"text": 3}, {"words": 4}])
def test_what_there_is_not(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        caption_provider(conf("caption", "text") | change, RASTER)
