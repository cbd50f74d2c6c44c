"""Serves pages to the browsers of this computer alone, to whoever was given the address.

The address holds a token that other accounts of the computer do not know. Pages from elsewhere cannot reach it either:
the `Host` header has to name this computer (against DNS rebinding), a sender has to be of the same origin, and no
answer may be kept, framed, or read by another origin.
"""

import secrets
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread
from typing import Any

from labrig.errors import InputError
from labrig.report.web_page import LOCALHOST

_POLICY = (
    "default-src 'none'; img-src 'self'; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": _POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_TIMEOUT_S = 10.0
_ENDED_WITHIN_S = 2.0
_MOST_SENT_BYTES = 1000
_JSON = "application/json"


@dataclass(frozen=True)
class Reply:
    """What a browser gets: content, its type, the status of HTTP, and further headers."""

    content: bytes
    kind: str = "text/plain; charset=utf-8"
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)


Answerer = Callable[[str, bytes | None], Reply | None]
"""Answers a path below the token, such as `state.json`, and the JSON that was sent to it; None if there is no such."""


class LocalServer:
    """A server on 127.0.0.1, in threads that end with the process.

    Parameters
    ----------
    answer : callable
        Answers requests; called by several threads.
    port : int
        Where it listens; 0 for any free port.

    Raises
    ------
    InputError
        When the port cannot be had.
    """

    def __init__(self, answer: Answerer, port: int = 0) -> None:
        self._token = secrets.token_urlsafe(16)
        try:
            self._server = _Server((LOCALHOST, port), _Handler)
        except OSError as error:
            raise InputError(
                f"port {port} of {LOCALHOST} cannot be had: {error.strerror}",
                "choose another --port, or leave it out",
            ) from error
        self._server.token, self._server.answer = self._token, answer
        self._thread = Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """The address of the page, with the token."""
        return f"http://{LOCALHOST}:{self.port}/{self._token}/"

    def finish_replies(self, within_s: float) -> None:
        """Wait until everybody who has asked or sent something has a reply, but not longer than this."""
        with self._server.is_idle:
            self._server.is_idle.wait_for(lambda: self._server.unanswered == 0, within_s)

    def close(self) -> None:
        """Stop listening, and let replies end: a thread that is inside OpenCV when Python ends aborts it."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self.finish_replies(_ENDED_WITHIN_S)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    token = ""
    answer: Answerer
    unanswered = 0

    def __init__(self, *place: Any) -> None:
        self.is_idle = Condition()
        super().__init__(*place)

    @contextmanager
    def count_unanswered(self) -> Iterator[None]:
        """Count a browser as one without a reply during the block."""
        with self.is_idle:
            self.unanswered += 1
        try:
            yield
        finally:
            with self.is_idle:
                self.unanswered -= 1
                self.is_idle.notify_all()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that has gone; whatever else fails is a bug."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """Answer with a page or a part of it."""
        with self.server.count_unanswered():
            self._reply(self._refuse() or self._answer(None))

    def do_POST(self) -> None:
        """Answer to a document that was sent."""
        with self.server.count_unanswered():
            self._reply(self._refuse() or self._refuse_sender() or self._answer(self._read_sent()))

    def _refuse(self) -> Reply | None:
        """Return why a request is not answered: it names another computer, or does not know the token."""
        own = {f"{name}:{self.server.server_address[1]}" for name in (LOCALHOST, "localhost")}
        if self.headers.get("Host", "") not in own:
            return Reply(b"this server answers to its own address only", status=421)
        given = self.path.split("/")[1] if self.path.startswith("/") else ""
        if not secrets.compare_digest(given.encode("utf-8", "replace"), self.server.token.encode()):
            return Reply(b"there is no such page", status=404)
        return None

    def _refuse_sender(self) -> Reply | None:
        """Return why a document is not taken: it comes from another page, is no JSON, or is long."""
        origin, host = self.headers.get("Origin"), self.headers.get("Host")
        length = self.headers.get("Content-Length", "")
        if origin is not None and origin != f"http://{host}":
            return Reply(b"another page may send nothing here", status=403)
        if self.headers.get("Content-Type") != _JSON:
            return Reply(b"only JSON is taken", status=415)
        if not (length.isascii() and length.isdecimal() and int(length) <= _MOST_SENT_BYTES):
            return Reply(b"too long", status=413)
        return None

    def _read_sent(self) -> bytes:
        return self.rfile.read(int(self.headers["Content-Length"]))

    def _answer(self, sent: bytes | None) -> Reply:
        name = self.path.split("?")[0].partition(f"/{self.server.token}/")[2]
        return self.server.answer(name, sent) or Reply(b"there is no such page", status=404)

    def _reply(self, reply: Reply) -> None:
        self.send_response(reply.status)
        sized = {"Content-Type": reply.kind, "Content-Length": str(len(reply.content))}
        for name, value in {**_HEADERS, **sized, **reply.headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(reply.content)

    def version_string(self) -> str:
        """Return what the server calls itself."""
        return "labrig"

    def log_message(self, *_words: Any) -> None:
        """Write nothing on standard error."""
