"""The view for the rerun viewer, made from the record: saved, and live."""

import shutil
from pathlib import Path

import pytest

from labrig.analysis.result import NO_LINES, CentreLines, load_centre_lines
from labrig.devices.clocks import SystemClock
from labrig.devices.drives.states import describe_statusword
from labrig.errors import RecordError
from labrig.experiments.registry import follow_run
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun, LinedPicture
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import open_run
from labrig.report.rerun_view import choose_pictures, show_live, write_view
from labrig.report.view import NO_VIEW
from labrig.report.viewer import find_viewer, start_viewer
from tests.analysis.synthetic import record_sweep
from tests.report.conftest import WrittenPage
from tests.rerun_files import read_colours, read_view

RECORDS = Path(__file__).parents[1] / "records"


def _lines(page: WrittenPage) -> CentreLines:
    """Return the shafts that were found."""
    assert page.result is not None
    return load_centre_lines(page.result.path)


def test_the_view_is_made_with_and_without_a_result(page: WrittenPage, tmp_path: Path) -> None:
    """A view holds the pictures either way, is replaced when made again, and leaves nothing half-written."""
    with_lines = write_view(page.run, _lines(page), NO_VIEW, describe_statusword)
    assert with_lines == page.run.path / "view.rrd"
    assert with_lines.stat().st_size > 50_000
    assert write_view(page.run, _lines(page), NO_VIEW, describe_statusword) == with_lines
    assert write_view(record_sweep(tmp_path), NO_LINES, NO_VIEW, describe_statusword).stat().st_size > 50_000
    assert list(page.run.path.glob(".view*")) == []


def test_a_damaged_picture_leaves_no_view(tmp_path: Path) -> None:
    """A view is whole or is not there."""
    run = record_sweep(tmp_path)
    (run.path / "frames" / "000000.png").write_bytes(b"no picture")
    with pytest.raises(RecordError, match=r"000000\.png"):
        write_view(run, NO_LINES, NO_VIEW, describe_statusword)
    assert list(run.path.glob("*view.rrd*")) == []


def test_the_last_picture_is_marked_as_old_once_the_needle_is_withdrawn(tmp_path: Path) -> None:
    """The mark says at which depth it was taken, and goes with the next picture."""
    run = open_run(shutil.copytree(RECORDS / "steerability", tmp_path / "run"))
    shown = read_view(write_view(run, NO_LINES, NO_VIEW, describe_statusword))
    trials = len(run.trials)
    assert len(shown["/camera/old/words"]) == trials > 0
    depth_mm = max(line.insertion_mm for line in run.frame_lines if line.insertion_mm is not None)
    assert shown["/camera/old/words"][-1].startswith(f"OLD PICTURE: taken at {depth_mm:.1f} mm")
    assert shown["/events"][0].startswith("run starts")


def test_curves_of_a_plot_differ_in_colour(tmp_path: Path) -> None:
    """Every curve of an insertion has a colour, and no two of the same plot have the same."""
    run = open_run(shutil.copytree(RECORDS / "insertion", tmp_path / "run"))
    file = write_view(run, NO_LINES, follow_run(run), describe_statusword)
    colours = read_colours(file)
    curves = [
        place for place, values in read_view(file).items() if any(type(value) is float for value in values)
    ]
    assert {"/roll/rotation", "/roll/heading"} <= set(curves) <= colours.keys()
    for plot in {place.rpartition("/")[0] for place in curves}:
        shown = [colours[place] for place in curves if place.rpartition("/")[0] == plot]
        assert len(set(shown)) == len(shown), plot


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
        view = follow_run(open_run(RECORDS / "insertion"))
        show_live(
            GrowingRun(RECORDS / "insertion"),
            view,
            viewer,
            describe_statusword,
            clock=SystemClock(),
            tell=told.append,
        )
        assert (told, viewer.has_ended()) == ([], False)
    finally:
        viewer.process.kill()
        viewer.process.wait()
