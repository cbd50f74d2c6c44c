"""Starts the rerun viewer, a separate process that listens only on this computer and sends no usage data."""

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from http.client import HTTPConnection, HTTPException
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from labrig.clock import Clock
from labrig.errors import MachineError
from labrig.posix import end_with_parent, hold_signals
from labrig.report.local_server import LOCALHOST, LocalServer, Reply, say

DEFAULT_PORT, DEFAULT_WEB_PORT = 9876, 9090

ViewerKind = Literal["window", "web"]
"""A window, or a page for a browser, here or on another computer."""

_STARTS_WITHIN_S = 20.0
_LOOK_EVERY_S = 0.05
# The viewer's page would load a font from elsewhere, and sends usage data from the browser, where no setting of this
# computer holds it back. Under this policy (W3C Content Security Policy, level 3) the browser refuses both.
_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
    f"connect-src 'self' data: blob: http://{LOCALHOST}:{{}}"
)
_FETCHES_WITHIN_S = 10.0
# Memory of a server for viewers that come late; the oldest is dropped first.
_SERVER_MEMORY = "512MiB"


@dataclass(frozen=True)
class RunningViewer:
    """A viewer that listens: what it is, its process and its ports on this computer."""

    kind: ViewerKind
    process: subprocess.Popen[bytes]
    port: int
    web_port: int

    @property
    def url(self) -> str:
        """Where a stream is sent to."""
        return f"rerun+http://{LOCALHOST}:{self.port}/proxy"

    @property
    def page(self) -> str:
        """The address of the page for a browser."""
        return (
            f"http://{LOCALHOST}:{self.web_port}/?url=rerun%2Bhttp%3A%2F%2F{LOCALHOST}%3A{self.port}%2Fproxy"
        )

    def has_ended(self) -> bool:
        """Return whether somebody has closed it."""
        return self.process.poll() is not None


def find_viewer() -> str:
    """Return the program of the viewer: the one of the installed library, so that both have one version.

    It is started itself, without the script that starts it, which would leave it behind when it is ended.

    Raises
    ------
    MachineError
        When it is not installed.
    """
    package = find_spec("rerun_cli")
    beside = None if package is None or package.origin is None else str(Path(package.origin).parent)
    viewer = (beside and shutil.which("rerun", path=beside)) or shutil.which("rerun")
    if viewer is None:
        raise MachineError(
            "the rerun viewer is not installed", "install rerun-sdk, or copy view.rrd to where it is"
        )
    return viewer


def open_view(path: Path) -> None:
    """Open a file in the viewer.

    Raises
    ------
    MachineError
        When the viewer is not installed.
    """
    _start((find_viewer(), "--new", "--bind", LOCALHOST, str(path)), with_parent=False)


def start_viewer(kind: ViewerKind, clock: Clock, program: str) -> RunningViewer:
    """Start a viewer and wait until it listens, on its usual ports or, where those are in use, on free ones.

    A window stays when this process ends; the others end with it.

    Raises
    ------
    MachineError
        When it ends at once, or does not listen in time.
    """
    port, web_port, files_port = (
        find_free_port(DEFAULT_PORT),
        find_free_port(DEFAULT_WEB_PORT),
        find_free_port(0),
    )
    command = [program, "--bind", LOCALHOST, "--port", str(port)]
    if kind == "window":
        command += ["--hide-welcome-screen", "--expect-data-soon"]
    else:
        command += [
            "--server-memory-limit",
            _SERVER_MEMORY,
            "--serve-web",
            "--web-viewer-port",
            str(files_port),
        ]
    viewer = RunningViewer(kind, _start(command, with_parent=kind != "window"), port, web_port)
    waited_from_s = clock.now_s()
    while not _listens(port):
        if viewer.has_ended():
            raise MachineError(
                f"the rerun viewer ended with status {viewer.process.returncode} when it was started",
                f"try it: {' '.join(command)}",
            )
        if clock.now_s() > waited_from_s + _STARTS_WITHIN_S:
            viewer.process.kill()
            raise MachineError(f"the rerun viewer did not listen within {_STARTS_WITHIN_S:.0f} s", "try it")
        clock.sleep(_LOOK_EVERY_S)
    if kind == "web":
        LocalServer(partial(_fetch, files_port), {"Content-Security-Policy": _POLICY.format(port)}, web_port)
    return viewer


def _fetch(port: int, path: str) -> Reply:
    """Pass on what a browser asks for: a file of the viewer's own server."""
    try:
        with closing(HTTPConnection(LOCALHOST, port, timeout=_FETCHES_WITHIN_S)) as viewer:
            viewer.request("GET", path)
            found = viewer.getresponse()
            return found.status, found.getheader("Content-Type", ""), found.read()
    except (OSError, HTTPException):
        return say(502, "the viewer has ended")


def has_display(environment: Mapping[str, str]) -> bool:
    """Return whether windows can be opened here."""
    if sys.platform == "darwin":
        return True
    return any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def find_free_port(wanted: int) -> int:
    """Return a port of this computer on which nothing listens, the wanted one if possible."""
    for port in (wanted, 0):
        with suppress(OSError), closing(socket.socket()) as free:
            # Connections of the last run that linger do not keep its port from this one; a listener does.
            free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            free.bind((LOCALHOST, port))
            return int(free.getsockname()[1])
    raise MachineError("this computer has no free port", "close programs that listen on many")


def _listens(port: int) -> bool:
    with suppress(OSError), closing(socket.create_connection((LOCALHOST, port), timeout=1.0)):
        return True
    return False


def _start(command: Sequence[str], *, with_parent: bool) -> subprocess.Popen[bytes]:
    with hold_signals():  # it forks
        return subprocess.Popen(  # noqa: S603 - the viewer that was found, with paths and ports that labrig made
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=_without_usage_data(os.environ),
            preexec_fn=end_with_parent if with_parent else None,  # noqa: PLW1509 - this process has no threads
        )


def _without_usage_data(environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment in which the viewer sends no usage data: it never does where CI is set."""
    return {key: value for key, value in environment.items() if key != "FORCE_RERUN_ANALYTICS"} | {"CI": "1"}
