"""A caption by a service that speaks OpenAI's chat completions and looks at pictures."""

from __future__ import annotations

import base64
import dataclasses
import random
import re
from collections.abc import Mapping
from typing import Any, Literal

import cv2
import numpy as np

from soar.artifacts import encode_image
from soar.caption.records import Caption, Footage, Sighting
from soar.caption.service import Service, ServiceSettings
from soar.errors import ConfigError
from soar.raster import RasterSettings

_DECLINED = re.compile(r"\b(sorry|cannot|can't|can not|unable|as an ai)\b", re.IGNORECASE)
_LETTERS = 0.7  # least share of letters in a sentence
_COUNTED = ("prompt_tokens", "completion_tokens", "total_tokens")


@dataclasses.dataclass(frozen=True)
class OpenAISettings:
    """Node ``caption`` with the provider ``openai``; ``conf/caption/openai.yaml`` tells what the fields mean."""

    provider: Literal["openai"]
    frames: int
    long_side: int
    detail: Literal["low", "high", "auto"]
    jpeg_quality: int
    service: ServiceSettings
    model: str
    max_tokens: int
    token_field: Literal["max_tokens", "max_completion_tokens"]
    temperature: float | None
    words: tuple[int, int]
    instruction: str

    def __post_init__(self) -> None:
        if min(self.long_side, self.max_tokens) < 1 or not 1 <= self.jpeg_quality <= 100:
            raise ConfigError(
                "a number of caption is out of range",
                expected="long_side and max_tokens of 1 or more, jpeg_quality of 1 to 100",
                got=f"{self.long_side}, {self.max_tokens}, {self.jpeg_quality}",
            )


class OpenAI:
    """Asks for one sentence about a few photographs."""

    def __init__(self, options: OpenAISettings, raster: RasterSettings) -> None:
        self.options, self.frames = options, options.frames
        self._service = Service(options.service, random.SystemRandom())

    def caption(self, footage: Footage) -> Caption:
        """See :class:`soar.caption.records.CaptionProvider`.

        Raises:
            ServiceError: the service is down, slow, refuses, or answers nonsense.
        """
        pictures = tuple(map(self._picture, footage.sightings))
        reply = self._service.post("/chat/completions", self._question(pictures))
        return Caption(
            text=self._sentence(reply),
            evidence={
                "host": self._service.host,
                "model": self.options.model,
                "requests": self._service.asked,
                "usage": _usage(reply),
            },
            numbers={"requests": self._service.asked},
            pictures=pictures,
        )

    def _picture(self, sighting: Sighting) -> np.ndarray:
        """(H, W, 3) uint8 the person on white, no larger than ``long_side``."""
        ys, xs = (np.flatnonzero((sighting.alpha > 127).any(axis)) for axis in (1, 0))
        window = np.s_[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
        alpha = sighting.alpha[window][..., None] / 255
        picture = np.round(alpha * sighting.rgb[window] + (1 - alpha) * 255).astype(np.uint8)
        scale = self.options.long_side / max(picture.shape[:2])
        if scale < 1:
            size = tuple(max(1, round(scale * side)) for side in picture.shape[1::-1])
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        return picture

    def _question(self, pictures: tuple[np.ndarray, ...]) -> dict[str, Any]:
        options = self.options
        content: list[dict[str, Any]] = [{"type": "text", "text": options.instruction}]
        for picture in pictures:
            data = base64.b64encode(encode_image(picture, ".jpg", options.jpeg_quality)).decode()
            url = f"data:image/jpeg;base64,{data}"
            content.append({"type": "image_url", "image_url": {"url": url, "detail": options.detail}})
        question = {
            "model": options.model,
            "messages": [{"role": "user", "content": content}],
            options.token_field: options.max_tokens,
        }
        return question if options.temperature is None else question | {"temperature": options.temperature}

    def _sentence(self, reply: Any) -> str:
        """The sentence in a reply, if it is one."""
        least, most = self.options.words
        expected = f"one sentence of {least} to {most} words"
        try:
            choice = reply["choices"][0]
            said, ended = choice["message"]["content"], choice.get("finish_reason")
        except (KeyError, IndexError, TypeError, AttributeError):
            raise self._service.nonsense("choices[0].message.content", str(reply)) from None
        if not isinstance(said, str):
            raise self._service.nonsense(expected, str(choice["message"].get("refusal") or said))
        text = said.strip().strip("\"'“”").strip()
        if ended in ("length", "content_filter"):
            raise self._service.nonsense(f"{expected}, ended", f"{ended}: {text}")
        sound = (
            least <= len(text.split()) <= most
            and len(text.splitlines()) == 1
            and text.isprintable()
            and sum(map(str.isalpha, text.replace(" ", ""))) >= _LETTERS * len(text.replace(" ", ""))
            and not _DECLINED.search(text)
            and self._service.without_key(text) == text
        )
        if not sound:
            raise self._service.nonsense(expected, text)
        return text


def _usage(reply: Any) -> dict[str, int]:
    """The tokens that the service says it counted."""
    usage = reply.get("usage") if isinstance(reply, Mapping) else None
    return (
        {name: usage[name] for name in _COUNTED if type(usage.get(name)) is int} if isinstance(usage, Mapping) else {}
    )
