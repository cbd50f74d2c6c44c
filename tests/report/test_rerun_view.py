"""The view for the rerun viewer, made from the record, saved and live; and the viewer as a process."""

import shutil
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.analysis.result import load_centre_lines
from labrig.devices.clocks import SystemClock
from labrig.devices.drives.states import describe_statusword
from labrig.errors import MachineError, RecordError
from labrig.experiments.registry import follow_run
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import open_run
from labrig.report.local_server import LOCALHOST
from labrig.report.rerun_view import choose_pictures, show_live, write_view
from labrig.report.view import NO_VIEW
from labrig.report.viewer import RunningViewer, find_viewer, start_viewer
from tests.rerun_files import read_view

RECORDS = Path(__file__).parents[1] / "records"
INSERTION = RECORDS / "insertion"
_LISTEN = "0A"
_LOCALHOST = "0100007F"


def test_the_view_is_made_with_and_without_a_result(tmp_path: Path) -> None:
    """It holds the pictures either way and is replaced when made again; one that cannot be whole is not there."""
    run = open_run(shutil.copytree(RECORDS / "steerability", tmp_path / "run"))
    for lines in ({}, load_centre_lines(run.path / "analysis" / "001")):
        file = write_view(run, lines, NO_VIEW, describe_statusword)
        assert (file, file.stat().st_size > 50_000) == (run.path / "view.rrd", True)
    file.unlink()
    (run.path / "frames" / "000000.png").write_bytes(b"no picture")
    with pytest.raises(RecordError, match=r"000000\.png"):
        write_view(open_run(run.path), {}, NO_VIEW, describe_statusword)
    assert list(run.path.glob("*view*")) == []


def test_the_last_picture_is_marked_as_old_once_the_needle_is_withdrawn(tmp_path: Path) -> None:
    """The mark says at which depth it was taken, and goes with the next picture."""
    run = open_run(shutil.copytree(RECORDS / "steerability", tmp_path / "run"))
    shown = read_view(write_view(run, {}, NO_VIEW, describe_statusword))
    assert len(shown["/camera/old/words"]) == len(run.trials) > 0
    depth_mm = max(line.insertion_mm for line in run.frame_lines if line.insertion_mm is not None)
    assert shown["/camera/old/words"][-1].startswith(f"OLD PICTURE: taken at {depth_mm:.1f} mm")
    assert shown["/events"][0].startswith("run starts")


def test_all_pictures_are_of_one_form(tmp_path: Path) -> None:
    """Also a plan in colour among grey ones: the viewer shows no picture of an entity once their form changes."""
    run = open_run(shutil.copytree(INSERTION, tmp_path / "run"))
    assert {picture.ndim for picture in run.pictures} == {2, 3}
    shown = read_view(write_view(run, {}, NO_VIEW, describe_statusword))["/camera"]
    forms = {cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_UNCHANGED).ndim for blob in shown}
    assert (len(shown), forms) == (len(run.frame_lines), {3})


@pytest.mark.parametrize(("waiting", "drawn"), [(2, [0, 1]), (6, [1, 4, 5])])
def test_the_newest_and_the_needed_pictures_are_drawn(waiting: int, drawn: list[int]) -> None:
    """Of many pictures the newest are drawn, and those from which something is measured."""
    roles = ["final" if frame == 1 else "advance" for frame in range(waiting)]
    lines = [FrameLine(t_s=float(at), frame=at, file="", role=role) for at, role in enumerate(roles)]
    pictures = [RecordedPicture(Path(), line) for line in lines]
    chosen = choose_pictures(pictures, lambda line: line.role == "final", most=2)
    assert [picture.line.frame for picture in chosen] == drawn


@pytest.fixture
def viewer() -> Iterator[RunningViewer]:
    """A viewer without a window."""
    running = start_viewer("web", SystemClock(), find_viewer())
    yield running
    running.process.kill()
    running.process.wait()


def test_a_run_is_shown_to_its_end(viewer: RunningViewer) -> None:
    """Of a viewer that takes everything the person is told nothing, and it stays; one that was closed is told."""
    view, told = follow_run(open_run(INSERTION)), list[str]()
    for expected in ([], ["the viewer was closed; the run goes on without it"]):
        run, clock = GrowingRun(INSERTION), SystemClock()
        show_live(run, view, viewer, describe_statusword, clock=clock, tell=told.append)
        assert (told, viewer.has_ended()) == (expected, bool(expected))
        viewer.process.kill()
        viewer.process.wait()


def test_a_viewer_serves_this_computer_alone_and_sends_no_usage_data(viewer: RunningViewer) -> None:
    """Its page lets a browser talk to 127.0.0.1 alone; every socket on which it listens is bound to that."""
    status, tries = 502, 0
    while status == 502 and (tries := tries + 1) < 20:  # as a viewer on a busy machine answers late
        with closing(HTTPConnection(LOCALHOST, viewer.web_port, timeout=300)) as browser:
            browser.request("GET", "/")
            page = browser.getresponse()
            status, content = page.status, page.read()
            policy = page.getheader("Content-Security-Policy") or ""
    assert b"<canvas" in content or b"re_viewer" in content
    assert f"connect-src 'self' data: blob: http://{LOCALHOST}:{viewer.port}" in policy
    assert "*" not in policy
    process = Path("/proc") / str(viewer.process.pid)
    sockets = {link.readlink().name for link in (process / "fd").iterdir()}
    tables = ((process / "net" / name).read_text() for name in ("tcp", "tcp6"))
    rows = [line.split() for table in tables for line in table.splitlines()]
    listening = [row[1] for row in rows if row[3] == _LISTEN and f"socket:[{row[9]}]" in sockets]
    assert {address.split(":")[0] for address in listening} == {_LOCALHOST}
    assert b"CI=1" in (process / "environ").read_bytes().split(b"\0")


def test_a_viewer_that_ends_at_once_is_reported(tmp_path: Path) -> None:
    """The message has its status and the command to try."""
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 7\n")
    broken.chmod(0o755)
    with pytest.raises(MachineError, match="ended with status 7"):
        start_viewer("web", SystemClock(), str(broken))
