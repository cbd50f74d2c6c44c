"""A live view of a run, and which pictures it draws of those that wait."""

from pathlib import Path

import pytest

from labrig.devices.clocks import SystemClock
from labrig.devices.drives.states import describe_statusword
from labrig.experiments.registry import follow_run
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun, LinedPicture
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import open_run
from labrig.report.rerun_view import choose_pictures, show_live
from labrig.report.viewer import find_viewer, start_viewer

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


def test_a_run_is_shown_to_its_end() -> None:
    """A viewer that takes everything is told nothing, and neither is the person; the viewer stays."""
    viewer = start_viewer("web", SystemClock(), find_viewer())
    told: list[str] = []
    try:
        view = follow_run(open_run(_RECORDED))
        show_live(
            GrowingRun(_RECORDED), view, viewer, describe_statusword, clock=SystemClock(), tell=told.append
        )
        assert (told, viewer.has_ended()) == ([], False)
    finally:
        viewer.process.kill()
        viewer.process.wait()
