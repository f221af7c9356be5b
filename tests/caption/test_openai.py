"""The service against a small server that speaks the protocol, well and badly."""

from __future__ import annotations

import base64
import email.utils
import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler
from typing import Any

import cv2
import numpy as np
import pytest

from soar.caption.records import Caption, Footage
from soar.caption.registry import caption_provider
from soar.caption.service import retry_after
from soar.errors import ConfigError, ServiceError
from soar.raster import RasterSettings
from tests.caption import people
from tests.caption.service import KEY, SENTENCE, Answer, Server, refuses, reply, says
from tests.conftest import conf

QUICK = {"connect_s": 1.0, "read_s": 0.25, "deadline_s": 3.0, "backoff_s": 0.01}
SECRET = KEY[3:]


@pytest.fixture(scope="module")
def footage() -> Footage:
    return people.footage(lambda bone, share: people.SKIN, frames=2)


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


class Ask:
    """Asks a server that answers by a script; the key must appear in nothing that comes back."""

    def __init__(self, footage: Footage, stack: ExitStack) -> None:
        self._footage, self._stack = footage, stack

    def __call__(self, *script: Answer | str, service: dict[str, Any] | None = None, **node: Any) -> Caption:
        server = Server(tuple(getattr(self, a) if isinstance(a, str) else a for a in script))
        self.server = self._stack.enter_context(server.running())
        default = conf("caption", "openai")
        settings = default["service"] | QUICK | {"base_url": self.server.url} | (service or {})
        node = default | node | {"service": settings}
        return caption_provider(node, RasterSettings(1 / 12, True, True, "auto")).caption(self._footage)

    def hangs(self, handler: BaseHTTPRequestHandler) -> None:
        self.server.hangs(handler)

    def drips(self, handler: BaseHTTPRequestHandler) -> None:
        self.server.drips(handler)

    def fails(self, *script: Answer | str, says: str, got: str = "", **how: Any) -> ServiceError:
        with pytest.raises(ServiceError) as caught:
            self(*script, **how)
        message = str(caught.value)
        assert says in message
        assert got in message
        assert "caption=template" in caught.value.cure
        assert SECRET not in message
        assert SECRET[:12] not in message
        return caught.value


@pytest.fixture
def ask(footage: Footage, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]) -> Iterator[Ask]:
    with caplog.at_level(logging.DEBUG), ExitStack() as stack:
        yield Ask(footage, stack)
    printed = capfd.readouterr()
    assert SECRET not in caplog.text + printed.out + printed.err


def test_a_sentence(ask: Ask, footage: Footage) -> None:
    caption = ask(says(f'  "{SENTENCE}"\n'))
    assert caption.text == SENTENCE
    assert caption.numbers == {"requests": 1}
    assert caption.evidence == {
        "host": "127.0.0.1",
        "model": "gpt-4o-mini",
        "requests": 1,
        "usage": {"prompt_tokens": 400, "completion_tokens": 20, "total_tokens": 420},
    }
    assert SECRET not in repr(caption)
    (asked,) = ask.server.asked
    assert asked["path"] == "/v1/chat/completions"
    assert asked["headers"]["Authorization"] == f"Bearer {KEY}"
    assert asked["body"]["max_tokens"] == 120
    assert asked["body"]["temperature"] == 0
    (message,) = asked["body"]["messages"]
    instruction, *pictures = message["content"]
    assert "one person" in instruction["text"]
    assert len(pictures) == len(footage.sightings)
    for sent, kept in zip(pictures, caption.pictures, strict=True):
        assert sent["image_url"]["detail"] == "low"
        head, data = sent["image_url"]["url"].split(",")
        assert head == "data:image/jpeg;base64"
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == kept.shape
        assert (picture[:10, :10] > 240).all()  # the background is left out


def test_what_is_sent_is_bounded(ask: Ask) -> None:
    caption = ask(says(SENTENCE), long_side=64, max_tokens=30, token_field="max_completion_tokens", temperature=None)
    assert max(max(picture.shape) for picture in caption.pictures) == 64
    body = ask.server.asked[0]["body"]
    assert body["max_completion_tokens"] == 30
    assert not {"max_tokens", "temperature"} & body.keys()


def test_a_failure_that_passes(ask: Ask) -> None:
    caption = ask(refuses(500, "oops"), reply(503, b"<html>busy</html>"), says(SENTENCE))
    assert caption.text == SENTENCE
    assert caption.evidence["requests"] == len(ask.server.asked) == 3


def test_one_that_does_not_pass(ask: Ask) -> None:
    ask.fails(*[refuses(500, "oops")] * 3, says="refuses", got="HTTP 500: oops", service={"requests": 3})
    assert len(ask.server.asked) == 3


def test_it_waits_as_long_as_it_is_told(ask: Ask) -> None:
    started = time.monotonic()
    assert ask(refuses(429, "slow down", Retry_After="1"), says(SENTENCE)).text == SENTENCE
    assert 0.9 < time.monotonic() - started < 2.9


@pytest.mark.parametrize(
    ("value", "least", "most"),
    [("7", 7, 7), ("-7", 0, 0), ("soon", 0, 0), ("1e400", 0, 0), (None, 0, 0), ("Mon, 01 Jan 2001 00:00:00 GMT", 0, 0)],
)
def test_how_long_it_is_told_to_wait(value: str | None, least: float, most: float) -> None:
    headers = {} if value is None else {"Retry-After": value}
    assert least <= retry_after(headers) <= most
    assert 50 < retry_after({"Retry-After": email.utils.formatdate(time.time() + 60, usegmt=True)}) <= 60


def test_it_does_not_wait_longer_than_it_may(ask: Ask) -> None:
    started = time.monotonic()
    ask.fails(refuses(429, "slow down", Retry_After="3600"), says="refuses", got="asks to wait 3600 s")
    assert time.monotonic() - started < 3  # not read_s
    ask.fails(refuses(429, "none left", "insufficient_quota"), says="refuses", got="none left")
    assert len(ask.server.asked) == 1


@pytest.mark.parametrize("how", ["hangs", "drips"])
def test_a_slow_one(ask: Ask, how: str) -> None:
    started = time.monotonic()
    error = ask.fails(how, how, how, says="does not answer in time", got="after 2 requests", service={"requests": 2})
    assert 0.45 < time.monotonic() - started < 2
    assert "read_s" in error.cure
    started = time.monotonic()
    limits = {"requests": 9, "read_s": 5.0, "deadline_s": 0.5}
    ask.fails(how, says="does not answer in time", service=limits)
    assert time.monotonic() - started < 3  # not read_s


def test_one_that_is_down(ask: Ask) -> None:
    def hangs_up(handler: BaseHTTPRequestHandler) -> None:
        handler.close_connection = True

    ask.fails(hangs_up, hangs_up, says="cannot be reached", service={"requests": 2})
    ask.fails(says="cannot be reached", got="refused", service={"base_url": "http://127.0.0.1:9/v1"})
    cut = reply(200, b'{"choices": [', Content_Length="4000")
    ask.fails(cut, says="cannot be reached", service={"requests": 1})


@pytest.mark.parametrize("status", [401, 403])
def test_a_wrong_key(ask: Ask, status: int) -> None:
    error = ask.fails(refuses(status, f"Incorrect API key provided: {KEY}"), says="refuses", got=f"HTTP {status}")
    assert "OPENAI_API_KEY" in error.cure
    assert "Incorrect" not in str(error)
    assert len(ask.server.asked) == 1


def test_other_refusals_are_told_without_the_key(ask: Ask) -> None:
    error = ask.fails(refuses(404, f"no model for {KEY} or {KEY[:15]}..."), says="refuses", got="HTTP 404: no model")
    assert "caption.model" in error.cure
    assert len(ask.server.asked) == 1


def test_no_redirect_is_followed(ask: Ask) -> None:
    other = Server((says(SENTENCE),))
    with other.running():
        moved = reply(307, b"", Location=f"{other.url}/chat/completions?token={KEY}")
        error = ask.fails(moved, says="refuses", got="HTTP 307 to 127.0.0.1/v1/chat/completions")
    assert "base_url" in error.cure
    assert not other.asked


@pytest.mark.parametrize(
    "answer",
    [
        reply(200, b"<html>hello</html>"), reply(200, b"\xff\xfe\x00"), reply(200, b"[" * 100_000), reply(200, []),
        reply(200, {"choices": []}), reply(200, {"choices": [{"message": None}]}), reply(200, b"x" * (1 << 21)),
        says(""), says(None), says(["A man"]), says("Blue."), says("A man in blue. " * 40), says("1 2 3 4 5 6 7 8 9"),
        says("I'm sorry, but I can't help with that."), says("A man\n- blue cap\n- black shorts"),
        says(f"A man whose key is {KEY} with shorts"), says(SENTENCE[:20], "length"), says(SENTENCE, "content_filter"),
    ],
)  # fmt: skip
def test_nonsense(ask: Ask, answer: Answer) -> None:
    ask.fails(answer, says="answers nonsense")
    assert len(ask.server.asked) == 1


@pytest.mark.parametrize("value", ["", "short", "two words in a key", "línea-de-clave-secreta", "new\nline-in-the-key"])
def test_a_key_that_is_none(ask: Ask, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", value)
    with pytest.raises(ConfigError, match="OPENAI_API_KEY") as caught:
        ask(says(SENTENCE))
    assert not value or value not in str(caught.value)
    assert not ask.server.asked


def test_a_service_without_a_key(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY")
    assert ask(says(SENTENCE), service={"key_variable": None}).text == SENTENCE
    assert "Authorization" not in ask.server.asked[0]["headers"]


@pytest.mark.parametrize(
    ("url", "what"),
    [
        ("ftp://host/v1", "usable address"),
        ("https://me:password@host/v1", "usable address"),
        ("https://host/v1?key=password", "usable address"),
        ("https://host:port/v1", "usable address"),
        ("host/v1", "usable address"),
        ("http://example.org/v1", "unencrypted"),
    ],
)
def test_an_address_that_is_none(ask: Ask, url: str, what: str) -> None:
    with pytest.raises(ConfigError, match=what) as caught:
        ask(service={"base_url": url})
    assert "password" not in caught.value.got


def test_settings_out_of_range(ask: Ask) -> None:
    for wrong in ({"frames": 0}, {"max_tokens": 0}, {"jpeg_quality": 0}):
        with pytest.raises(ConfigError):
            ask(**wrong)
    for wrong in ({"requests": 0}, {"read_s": 0.0}, {"backoff_s": -1.0}):
        with pytest.raises(ConfigError):
            ask(service=wrong)
