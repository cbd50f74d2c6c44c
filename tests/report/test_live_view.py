"""Which pictures a live view draws of those that wait."""

from pathlib import Path

import pytest
import rerun as rr

from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives.states import describe_statusword
from labrig.experiments.registry import follow_run
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun, LinedPicture
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import open_run
from labrig.report.live_view import LiveView, choose_pictures
from labrig.report.record_drawing import RecordDrawing

_RECORDED = Path(__file__).parents[1] / "records" / "insertion"


def _picture(frame: int) -> LinedPicture:
    line = FrameLine(t_s=float(frame), frame=frame, file="", role="final" if frame == 1 else "advance")
    return LinedPicture(line, RecordedPicture(Path(), "", ""))


@pytest.mark.parametrize(("waiting", "drawn"), [(2, [0, 1]), (6, [1, 4, 5])])
def test_the_newest_and_the_needed_pictures_are_drawn(waiting: int, drawn: list[int]) -> None:
    """Of many pictures the newest are drawn, and those from which something is measured."""
    pictures = [_picture(frame) for frame in range(waiting)]
    chosen = choose_pictures(pictures, lambda line: line.role == "final", most=2)
    assert [picture.line.frame for picture in chosen] == drawn


def test_pictures_taken_before_the_view_began_are_not_blamed_on_its_speed(tmp_path: Path) -> None:
    """A resumed run has pictures already: those left out are not counted as too slow to draw."""
    run = open_run(_RECORDED)
    view = follow_run(run)
    stream = rr.RecordingStream("labrig-test")
    stream.save(tmp_path / "shown.rrd")
    drawing = RecordDrawing(stream, view, describe_statusword)
    told: list[str] = []
    live = LiveView(stream, drawing, view, GrowingRun(_RECORDED), SimulatedClock(), told.append)
    shown = live.follow(lambda: False)
    assert 0 < shown.drawn < len(run.frame_lines)
    assert (shown.left_out, told) == (0, [])
