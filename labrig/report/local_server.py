"""A server for browsers on this computer: it listens on 127.0.0.1 alone, and answers to that name alone."""

import sys
from collections.abc import Callable, Mapping
from getpass import getuser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from platform import node
from threading import Thread
from typing import Any

LOCALHOST = "127.0.0.1"

Reply = tuple[int, str, bytes]
"""Status of HTTP, type and content."""

_TIMEOUT_S = 10.0


class LocalServer(ThreadingHTTPServer):
    """Answers from now on, in threads of this process.

    Parameters
    ----------
    answer : callable
        Returns the reply to a path with its query.
    headers : Mapping
        Of every reply.
    port : int
        Where it listens; 0 for a free one.

    Raises
    ------
    OSError
        When the port is in use.
    """

    daemon_threads = (
        False  # closing waits for them: a thread that is inside OpenCV when Python ends aborts it
    )

    def __init__(self, answer: Callable[[str], Reply], headers: Mapping[str, str], port: int = 0) -> None:
        super().__init__((LOCALHOST, port), _Handler)
        self.answer, self.headers = answer, headers
        self.port = int(self.server_address[1])
        self._thread = Thread(target=self.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening, once everybody who has asked or sent something has a reply."""
        self.shutdown()
        self.server_close()
        self._thread.join()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that has gone; whatever else fails is a bug."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: LocalServer
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """Answer with a page or a part of it; a request that names another computer comes by DNS rebinding."""
        own = {f"{name}:{self.server.port}" for name in (LOCALHOST, "localhost")}
        status, kind, content = (
            self.server.answer(self.path)
            if self.headers.get("Host", "") in own
            else say(421, "this server answers to its own address only")
        )
        self.send_response(status)
        for name, value in self.server.headers.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def version_string(self) -> str:
        """Return what the server calls itself."""
        return "labrig"

    def log_message(self, *_words: Any) -> None:
        """Write nothing on standard error."""


def say(status: int, text: str) -> Reply:
    """Return a reply in plain text."""
    return status, "text/plain; charset=utf-8", text.encode()


def suggest_forwarding(*ports: int) -> str:
    """Return how to reach ports of this computer from another one; the command is a line that nothing breaks."""
    forward = " ".join(f"-L {port}:{LOCALHOST}:{port}" for port in ports)
    return f"from another computer, type there first:\nssh {forward} {getuser()}@{node()}"
