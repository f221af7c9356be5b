"""Asking a web service: JSON in, JSON out, with a key that is shown to nobody else, and bounds on time and requests."""

from __future__ import annotations

import contextlib
import dataclasses
import email.utils
import http.client
import json
import os
import random
import re
import socket
import ssl
import threading
import time
from collections.abc import Mapping
from datetime import datetime, timezone
from typing import Any
from urllib.parse import urlsplit

from soar.errors import ConfigError, ServiceError

_MOST_BYTES = 1 << 20  # of an answer that is read
_AGAIN = (408, 409, 425, 429, 500, 502, 503, 504)  # what may pass
_PART = 8  # so many characters of the key in a row are a part of it and no coincidence
_HERE = ("localhost", "127.0.0.1", "::1")
_OTHERWISE = "or choose caption=template, which asks nobody"


@dataclasses.dataclass(frozen=True)
class ServiceSettings:
    """Where the service is and how long it is waited for; ``conf/caption/openai.yaml`` tells what the fields mean."""

    base_url: str
    key_variable: str | None
    connect_s: float
    read_s: float
    deadline_s: float
    requests: int
    backoff_s: float

    def __post_init__(self) -> None:
        if min(self.connect_s, self.read_s, self.deadline_s) <= 0 or self.backoff_s < 0 or self.requests < 1:
            raise ConfigError("caption.service has a time or number out of range", got=str(self))


class Service:
    """One service, asked by POST.

    Redirects are not followed: the key and the pictures are for the host that the configuration names. Proxies of the
    environment are not used.

    Args:
        settings: see :class:`ServiceSettings`.
        rng: of the waits. Not a seeded one: it keeps jobs that were refused together from coming back together.

    Raises:
        ConfigError: the address is none, would carry the key unencrypted, or the key is not there or not usable.
    """

    def __init__(self, settings: ServiceSettings, rng: random.Random) -> None:
        self.settings, self._rng = settings, rng
        self._key = _key(settings.key_variable)
        self.host, self._port, self._encrypted, self._path = _address(settings.base_url, bool(self._key))
        self.asked = 0
        """Requests made so far."""

    def post(self, path: str, body: Mapping[str, Any]) -> Any:
        """The answer to ``body``, asked again with growing waits while the failure is one that may pass.

        Raises:
            ServiceError: no usable answer within the time and number of requests that the settings allow.
        """
        deadline = time.monotonic() + self.settings.deadline_s
        content = json.dumps(body).encode()
        for attempt in range(self.settings.requests):
            wait = self.settings.backoff_s * 2**attempt * self._rng.uniform(0.5, 1)
            try:
                status, headers, data = self._once(self._path + path, content, deadline)
            except TimeoutError as error:
                failure, cause = self._slow(), error
            except (OSError, http.client.HTTPException) as error:
                failure, cause = self._down(error), error
            else:
                if status == 200:
                    return self._json(data)
                failure, cause = self._refusal(status, headers, data), None
                if status not in _AGAIN or "insufficient_quota" in data.decode(errors="replace"):
                    raise failure
                wait = max(wait, retry_after(headers))
            left = deadline - time.monotonic()
            if attempt + 1 == self.settings.requests or wait >= left:
                raise failure from cause
            time.sleep(wait)
        raise AssertionError("at least one request is made")

    def without_key(self, text: str) -> str:
        """The text with every part of the key taken out."""
        for start in range(len(self._key) - _PART + 1):
            text = text.replace(self._key[start : start + _PART], "***")
        return text

    def excerpt(self, text: str) -> str:
        """The beginning of what a service said, in one printable line without the key."""
        return re.sub(r"[^\w\s!-~]|\s+", " ", self.without_key(text)).strip()[:200]

    def _once(self, path: str, content: bytes, deadline: float) -> tuple[int, Mapping[str, str], bytes]:
        """Status, headers and content of one answer; a TimeoutError where it is not whole in time."""
        self.asked += 1
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        limit = _left(deadline, self.settings.connect_s)
        if self._encrypted:
            connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                self.host, self._port, timeout=limit, context=ssl.create_default_context()
            )
        else:
            connection = http.client.HTTPConnection(self.host, self._port, timeout=limit)
        late = threading.Event()
        try:
            connection.connect()
            line = connection.sock
            limit = _left(deadline, self.settings.read_s)
            line.settimeout(limit)

            def hang_up() -> None:
                late.set()
                with contextlib.suppress(OSError):  # closed by the other side just now
                    socket.socket.shutdown(line, socket.SHUT_RDWR)  # TLS's own would take the reader's state away

            # A time-out of the socket starts anew with every byte; this one does not.
            alarm = threading.Timer(limit, hang_up)
            alarm.daemon = True
            alarm.start()
            try:
                connection.request("POST", path, content, headers)
                answer = connection.getresponse()
                data = answer.read(_MOST_BYTES + 1)
                if late.is_set():  # what was cut off need not be an error to the reader
                    raise TimeoutError
                if answer.length and len(data) <= _MOST_BYTES:
                    raise http.client.IncompleteRead(data, answer.length)
                return answer.status, answer.headers, data
            finally:
                alarm.cancel()
        except (OSError, http.client.HTTPException) as error:
            if late.is_set():
                raise TimeoutError from error
            raise
        finally:
            connection.close()

    def _json(self, data: bytes) -> Any:
        try:
            if len(data) > _MOST_BYTES:
                raise ValueError
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            raise self.nonsense("JSON of at most 1 MiB", data.decode(errors="replace")) from error

    def nonsense(self, expected: str, got: str) -> ServiceError:
        """The error of an answer that is none."""
        return ServiceError(
            f"the caption service {self.host} answers nonsense",
            expected=expected,
            got=self.excerpt(got) or "nothing",
            cure=f"check that caption.service.base_url speaks OpenAI's chat completions, try another caption.model, "
            f"{_OTHERWISE}",
        )

    def _down(self, error: Exception) -> ServiceError:
        return ServiceError(
            f"the caption service {self.host} cannot be reached",
            got=self.excerpt(str(error)) or type(error).__name__,
            cure=f"check caption.service.base_url and the network, try again later, {_OTHERWISE}",
        )

    def _slow(self) -> ServiceError:
        return ServiceError(
            f"the caption service {self.host} does not answer in time",
            expected=f"a connection within {self.settings.connect_s:g} s, an answer within {self.settings.read_s:g} s, "
            f"all within {self.settings.deadline_s:g} s",
            got=f"none after {self.asked} requests",
            cure=f"raise caption.service.read_s and deadline_s, try again later, {_OTHERWISE}",
        )

    def _refusal(self, status: int, headers: Mapping[str, str], data: bytes) -> ServiceError:
        said = f"HTTP {status}: {self.excerpt(_message(data))}"
        if 300 <= status < 400:
            new = urlsplit(headers.get("Location") or "")
            said = f"HTTP {status} to {self.excerpt(f'{new.hostname or self.host}{new.path}')}"
            cure = "redirects are not followed; if you trust that place, make it caption.service.base_url"
        elif status in (401, 403):
            said = f"HTTP {status}"  # what is said with it may show parts of the key
            cure = (
                f"check the key in the environment variable {self.settings.key_variable}, and what it may be used for"
            )
        elif status == 429:
            wait = f"; it asks to wait {retry_after(headers):g} s" if retry_after(headers) else ""
            said += f" (request {self.asked} of at most {self.settings.requests}{wait})"
            cure = "wait, raise caption.service.deadline_s, or raise the account's limits"
        elif status in _AGAIN:
            said += f" (request {self.asked} of at most {self.settings.requests})"
            cure = "try again later"
        else:
            cure = "check caption.service.base_url, caption.model, and the fields that the model takes"
        return ServiceError(f"the caption service {self.host} refuses", got=said, cure=f"{cure}, {_OTHERWISE}")


def _key(variable: str | None) -> str:
    """The key in an environment variable; empty where none is wanted."""
    if variable is None:
        return ""
    key = os.environ.get(variable, "").strip()
    if not re.fullmatch(rf"[!-~]{{{_PART},}}", key):
        raise ConfigError(
            f"the environment variable {variable} holds no usable key for the caption service",
            expected=f"a key of at least {_PART} printable characters without spaces",
            got="something else" if key else "nothing",
            cure=f"export {variable}=..., set caption.service.key_variable=null where none is needed, {_OTHERWISE}",
        )
    return key


def _address(url: str, keyed: bool) -> tuple[str, int, bool, str]:
    """Host, port, whether encrypted, and path of a base URL."""
    try:
        parts = urlsplit(url)
        port, host = parts.port, parts.hostname or ""
    except ValueError:
        parts, port, host = urlsplit(""), None, ""
    plain = parts.scheme == "http"
    sound = parts.scheme in ("http", "https") and re.fullmatch(r"[\w.:-]+", host)
    if not sound or parts.username or parts.password or parts.query or parts.fragment or re.search(r"\s", parts.path):
        raise ConfigError(
            "caption.service.base_url is no usable address",
            expected="https://host/path, without name, password or question mark",
            got=f"one with the host {host!r}",  # not the whole: what should not be in it may be secret
        )
    if plain and keyed and host not in _HERE:
        raise ConfigError(
            "caption.service.base_url would carry the key unencrypted",
            expected="https, or http on this machine",
            got=f"http to {host}",
            cure="use https, or caption.service.key_variable=null for a service of your own that asks for no key",
        )
    return host, port or (80 if plain else 443), not plain, parts.path.rstrip("/")


def _left(deadline: float, most: float) -> float:
    """Seconds to wait at most."""
    left = min(deadline - time.monotonic(), most)
    if left <= 0:
        raise TimeoutError
    return left


def _message(data: bytes) -> str:
    """What an error says, in the protocol's form or any other."""
    text = data[: 1 << 16].decode(errors="replace")
    try:
        return str(json.loads(text)["error"]["message"])
    except (ValueError, RecursionError, KeyError, TypeError):
        return text


def retry_after(headers: Mapping[str, str]) -> float:
    """Seconds that the service asks to wait; 0 where it does not."""
    value = (headers.get("Retry-After") or "").strip()
    if re.fullmatch(r"\d{1,9}", value):
        return float(value)
    try:
        until = email.utils.parsedate_to_datetime(value)
    except ValueError:
        return 0.0
    return max(0.0, (until - datetime.now(timezone.utc)).total_seconds()) if until.tzinfo else 0.0
