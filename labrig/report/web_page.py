"""Hands out rerun's page for a browser, with a policy under which it can reach nothing but this computer.

The page would load a font from elsewhere, and sends usage data from the browser, where no setting of this computer
holds it back. The browser itself refuses both by the page's Content-Security-Policy (W3C, level 3).
"""

from contextlib import closing
from functools import partial
from getpass import getuser
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from platform import node
from threading import Thread
from typing import Any

LOCALHOST = "127.0.0.1"
"""The only address on which anything listens for a live view."""

_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "connect-src 'self' data: blob: http://{host}:{port}"
)
_TIMEOUT_S = 10.0


def serve_page(port: int, viewer_web_port: int, viewer_port: int) -> None:
    """Hand out the page of a viewer from now on, on this computer alone, in a thread that ends with the process.

    Parameters
    ----------
    port : int
        Where browsers ask for it.
    viewer_web_port, viewer_port : int
        Where the viewer has its files and its data.

    Raises
    ------
    OSError
        When the port is in use.
    """
    policy = _POLICY.format(host=LOCALHOST, port=viewer_port)
    server = ThreadingHTTPServer((LOCALHOST, port), partial(_Handler, viewer_web_port, policy))
    Thread(target=server.serve_forever, daemon=True).start()


class _Handler(BaseHTTPRequestHandler):
    """Passes on what a browser asks for."""

    def __init__(self, viewer_web_port: int, policy: str, *request: Any) -> None:
        self._viewer_web_port = viewer_web_port
        self._policy = policy
        super().__init__(*request)

    def do_GET(self) -> None:
        """Answer with the viewer's file and the policy."""
        try:
            with closing(HTTPConnection(LOCALHOST, self._viewer_web_port, timeout=_TIMEOUT_S)) as viewer:
                viewer.request("GET", self.path)
                found = viewer.getresponse()
                status, kind, content = found.status, found.getheader("Content-Type", ""), found.read()
        except (OSError, HTTPException):
            self.send_error(502, "the viewer has ended")
            return
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", self._policy)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_words: Any) -> None:
        """Write nothing on standard error."""


def suggest_forwarding(*ports: int) -> str:
    """Return the command that makes ports of this computer those of another one, typed there."""
    forward = " ".join(f"-L {port}:{LOCALHOST}:{port}" for port in ports)
    return f"ssh {forward} {getuser()}@{node()}"
