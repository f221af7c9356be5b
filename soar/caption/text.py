"""A caption in the user's own words."""

from __future__ import annotations

import dataclasses
from typing import Literal

from soar.caption.records import Caption, Footage
from soar.errors import ConfigError
from soar.raster import RasterSettings


@dataclasses.dataclass(frozen=True)
class TextSettings:
    """Node ``caption`` with the provider ``text``.

    Attributes:
        provider: ``text``.
        frames: photographs shown beside the words.
        text: one sentence, or one for each sequence by its name.
    """

    provider: Literal["text"]
    frames: int
    text: str | dict[str, str]


class Text:
    """Says what it is told."""

    def __init__(self, options: TextSettings, raster: RasterSettings) -> None:
        self.options, self.frames = options, options.frames

    def caption(self, footage: Footage) -> Caption:
        """See :class:`soar.caption.records.CaptionProvider`.

        Raises:
            ConfigError: there are no words, or none for this sequence.
        """
        text = self.options.text
        words = text if isinstance(text, str) else text.get(footage.sequence, "")
        if not words.strip():
            raise ConfigError(
                f"caption.text has no words for the sequence {footage.sequence}",
                expected="a sentence that says what the person looks like, or one for each sequence by its name",
                got=repr(text),
                cure="give it, such as 'caption.text=\"A man with a blue cap, black shorts and bare feet.\"', "
                "or choose caption=template",
            )
        return Caption(" ".join(words.split()), evidence={})
