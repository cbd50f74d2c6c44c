"""`RUN/view.rrd`: the record on the time line of the rerun viewer; it can be deleted and made again.

Only neighbouring versions of the viewer read a rerun file, so this is a view and never a record. It has two time lines,
`rig_time` [s] and `frame`. The pictures are JPEG; measured ones show the shaft, those of an insertion also obstacles,
target, plan and path, with the curves of the estimate beside them. A live view is drawn by the same functions.
"""

from collections.abc import Mapping
from pathlib import Path
from threading import Thread
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from labrig.analysis.result import CentreLines
from labrig.durable import disk_errors, require_free_bytes, sync_file, temporary_file
from labrig.posix import sync_directory
from labrig.record.following import RecordLines, list_lines
from labrig.record.layout import TRIAL_START, VIEW
from labrig.record.reader import Run
from labrig.report.record_drawing import (
    CAMERA,
    CURVES,
    DRIVES,
    EVENTS,
    TIME,
    DescribeStatus,
    RecordDrawing,
    draw_shaft,
    set_time,
)
from labrig.report.view import View

_TITLE = "labrig"
# The needle has left the sheath when it stands out this far [mm].
_OUT_MM = 0.5
# Legends stand at the left of the plots: so much of the motion stays free there.
_LEGEND_SHARE = 0.3
_LIVE_WINDOW_S = 60.0
_SENT_WITHIN_S = 3.0
# Moves and arrivals are in the log too; the viewer shows them when asked for all levels.
_SHOWN_LEVELS = ("CRITICAL", "ERROR", "WARN", "INFO")


def write_view(run: Run, lines: CentreLines, view: View, describe_status: DescribeStatus) -> Path:
    """Write `RUN/view.rrd`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        A run of any experiment and exit status.
    lines : CentreLines
        The measured shafts.
    view : View
        The additions of its experiment.
    describe_status : callable
        What a statusword says of a drive.

    Raises
    ------
    RecordError
        When a picture of the record is missing or damaged.
    DiskError
        When the file cannot be written, or does not fit on the disk.
    """
    path = run.path / VIEW
    # rerun does not report a full disk. JPEG needs less space than the lossless pictures.
    files = {run.path / picture.file for picture in run.pictures.places}
    require_free_bytes(run.path, sum(file.stat().st_size for file in files if file.is_file()))
    with disk_errors(path), temporary_file(path) as unfinished:
        # Made here, because rerun does not report a folder that it cannot write either.
        unfinished.touch(exist_ok=False)
        _fill(unfinished, run, lines, view, describe_status)
        sync_file(unfinished)
        unfinished.replace(path)
        sync_directory(path.parent)
    return path


def _fill(file: Path, run: Run, lines: CentreLines, view: View, describe_status: DescribeStatus) -> None:
    recorded = list_lines(run)
    stream = rr.RecordingStream(_TITLE, recording_id=run.path.name)
    stream.save(file, default_blueprint=make_blueprint(view, _find_motion(recorded)))
    try:
        RecordDrawing(stream, view, describe_status).draw(recorded, recorded.pictures)
        if lines.px:
            for line in run.frame_lines:
                set_time(stream, line.t_s)
                draw_shaft(stream, [lines.px[line.frame]] if line.frame in lines.px else [])
        view.follow(stream, TIME, recorded)
        view.send(stream, TIME)
    finally:
        stream.disconnect()


def open_stream(run_name: str, url: str, view: View) -> rr.RecordingStream:
    """Return a stream to a viewer that listens at a URL; it opens at the newest that has arrived."""
    stream = rr.RecordingStream(_TITLE, recording_id=run_name)
    stream.connect_grpc(url, default_blueprint=make_blueprint(view, None))
    return stream


def end_stream(stream: rr.RecordingStream) -> None:
    """Send what is left, but wait for it only so long: for a viewer that takes nothing rerun waits without end."""
    ending = Thread(target=stream.disconnect, daemon=True)
    ending.start()
    ending.join(_SENT_WITHIN_S)


def make_blueprint(view: View, motion_s: tuple[float, float] | None) -> rrb.Blueprint:
    """Return the layout of the viewer: the camera and the log beside the curves, a plot for each unit.

    Parameters
    ----------
    view : View
        What the experiment adds; it stands first.
    motion_s : (float, float) or None
        Begin and end of what plots show [rig time, s]; None to follow what arrives.
    """
    whole = rr.TimeRange(rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.infinite())
    overviews = [_make_plot(*plot, whole) for plot in view.overviews]
    curves = [_make_plot(*plot, _make_window(motion_s)) for plot in (*view.curves, *CURVES)]
    documents = [rrb.TextDocumentView(origin=origin, name=name) for origin, name in view.documents]
    drives = rrb.StateTimelineView(
        origin=DRIVES, name="Drives", time_view=rrb.TimeAxis(view_range=_make_window(motion_s))
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin=CAMERA, name="Camera"),
                rrb.Horizontal(_make_log(), rrb.Vertical(*documents, drives), column_shares=[3, 2]),
                row_shares=[5, 3],
            ),
            rrb.Vertical(*overviews, *curves, row_shares=[*(5 for _ in overviews), *(3 for _ in curves)]),
            column_shares=[3, 2],
        ),
        # At the newest: of a saved run that is its last picture, with the path in it.
        rrb.TimePanel(timeline=TIME, state="collapsed", play_state="following"),
        collapse_panels=True,
    )


def _make_plot(origin: str, name: str, window: rr.TimeRange) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=rrb.TimeAxis(view_range=window))


def _make_window(motion_s: tuple[float, float] | None) -> rr.TimeRange:
    """Return what plots show: the motion or, of a run that is being made, what was just before."""
    if motion_s is None:
        before = rr.TimeRangeBoundary.cursor_relative(seconds=-_LIVE_WINDOW_S)
        return rr.TimeRange(before, rr.TimeRangeBoundary.cursor_relative(seconds=0.0))
    begin_s, end_s = motion_s
    begin_s -= _LEGEND_SHARE * (end_s - begin_s)
    return rr.TimeRange(*(rr.TimeRangeBoundary.absolute(seconds=t_s) for t_s in (begin_s, end_s)))


def _make_log() -> rrb.TextLogView:
    """Return the view of the events: time, level and sentence."""
    return rrb.TextLogView(
        origin=EVENTS,
        name="Events",
        rows=rrb.TextLogRows(filter_by_log_level=list(_SHOWN_LEVELS)),
        columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
    )


def _find_motion(lines: RecordLines) -> tuple[float, float] | None:
    """Return the rig time between which the needle is out of the sheath [s]; None if it never is.

    Of a run with trials, those are meant, and not what was found out before.
    """
    starts_s = (_time_of(event) for event in lines.events if event["kind"] == TRIAL_START)
    from_s = min(starts_s, default=0.0)
    out_s = [_time_of(state) for state in lines.states if _is_out(state)]
    out_s = [t_s for t_s in out_s if t_s >= from_s]
    return (out_s[0], out_s[-1]) if len(out_s) > 1 else None


def _is_out(state: Mapping[str, Any]) -> bool:
    return (state.get("insertion_mm") or 0.0) > _OUT_MM


def _time_of(line: Mapping[str, Any]) -> float:
    return float(line["t_s"])
