"""The viewer as a process: where it listens, and what it sends."""

import socket
import sys
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path

import pytest

from labrig.devices.clocks import SystemClock
from labrig.errors import MachineError
from labrig.report.local_server import LOCALHOST
from labrig.report.viewer import (
    RunningViewer,
    find_free_port,
    find_viewer,
    start_viewer,
)

_LISTEN = "0A"
_LOCALHOST = "0100007F"


@pytest.fixture
def viewer() -> Iterator[RunningViewer]:
    """A viewer without a window."""
    running = start_viewer("web", SystemClock(), find_viewer())
    yield running
    running.process.kill()
    running.process.wait()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_viewer_listens_on_this_computer_alone_and_sends_no_usage_data(viewer: RunningViewer) -> None:
    """Every socket on which it listens is bound to 127.0.0.1, and it is told to send nothing."""
    process = Path("/proc") / str(viewer.process.pid)
    sockets = {link.readlink().name for link in (process / "fd").iterdir()}
    rows = [
        line.split() for name in ("tcp", "tcp6") for line in (process / "net" / name).read_text().splitlines()
    ]
    listening = [row[1] for row in rows if row[3] == _LISTEN and f"socket:[{row[9]}]" in sockets]
    assert listening != []
    assert {address.split(":")[0] for address in listening} == {_LOCALHOST}
    environment = (process / "environ").read_bytes().split(b"\0")
    assert b"CI=1" in environment


def test_the_page_for_a_browser_reaches_nothing_else(viewer: RunningViewer) -> None:
    """Its policy lets the browser talk to this computer alone, so neither fonts nor usage data go out."""
    with closing(HTTPConnection(LOCALHOST, viewer.web_port, timeout=10)) as browser:
        browser.request("GET", "/")
        page = browser.getresponse()
        policy, content = page.getheader("Content-Security-Policy"), page.read()
    assert b"<canvas" in content or b"re_viewer" in content
    assert f"connect-src 'self' data: blob: http://{LOCALHOST}:{viewer.port}" in policy
    assert "*" not in policy


def test_a_port_in_use_is_left_to_its_user() -> None:
    """Another free port takes its place."""
    with socket.socket() as used:
        used.bind((LOCALHOST, 0))
        used.listen()
        taken = used.getsockname()[1]
        assert find_free_port(taken) != taken


def test_a_viewer_that_ends_at_once_is_reported(tmp_path: Path) -> None:
    """The message has its status and the command to try."""
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 7\n")
    broken.chmod(0o755)
    with pytest.raises(MachineError, match="ended with status 7"):
        start_viewer("web", SystemClock(), str(broken))
