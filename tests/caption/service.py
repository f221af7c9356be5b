"""A small server that speaks the protocol, answering as a script says."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

KEY = "sk-test-0123456789abcdefghij"
SENTENCE = "A man with a blue cap, a bare chest, black shorts and bare feet."

Answer = Callable[[BaseHTTPRequestHandler], None]


def reply(status: int = 200, content: Any = None, **headers: str) -> Answer:
    """An answer of bytes, or of anything else as JSON."""
    data = content if isinstance(content, bytes) else json.dumps(content).encode()

    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        for name, value in {"Content_Length": str(len(data)), **headers}.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(data)

    return answer


def says(text: Any, reason: str = "stop") -> Answer:
    """A completion."""
    choice = {"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": reason}
    usage = {"prompt_tokens": 400, "completion_tokens": 20, "total_tokens": 420}
    return reply(content={"id": "1", "object": "chat.completion", "choices": [choice], "usage": usage})


def refuses(status: int, message: str, code: str = "error", **headers: str) -> Answer:
    """An error in the protocol's form."""
    return reply(status, {"error": {"message": message, "type": code, "code": code}}, **headers)


class Server:
    """What was asked, and where."""

    def __init__(self, script: tuple[Answer, ...]) -> None:
        self.asked: list[dict[str, Any]] = []
        self.released = threading.Event()
        """Set at the end: for answers that hang."""
        left = iter(script)

        class Handler(BaseHTTPRequestHandler):
            def do_POST(handler) -> None:
                body = json.loads(handler.rfile.read(int(handler.headers["Content-Length"])))
                self.asked.append({"path": handler.path, "headers": dict(handler.headers), "body": body})
                next(left)(handler)

            def log_message(handler, *arguments: object) -> None:
                """Silence."""

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._http.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._http.server_address[1]}/v1"

    def hangs(self, handler: BaseHTTPRequestHandler) -> None:
        """Says nothing."""
        self.released.wait(10)

    def drips(self, handler: BaseHTTPRequestHandler) -> None:
        """Sends a byte now and then, without end."""
        handler.wfile.write(b"HTTP/1.1 200 OK\r\nX-Slow: ")
        while not self.released.wait(0.05):
            handler.wfile.write(b"x")
            handler.wfile.flush()

    @contextmanager
    def running(self) -> Iterator[Server]:
        thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self.released.set()
            self._http.shutdown()
            self._http.server_close()
            thread.join()
