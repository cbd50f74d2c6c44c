"""A record on the time line of the rerun viewer: saved as `RUN/view.rrd`, or live while the run is made.

Both are drawn by the same functions, all at once or line by line. There are two time lines, `rig time` [s] and `frame`.
Only neighbouring versions of the viewer read a rerun file, so this is a view and never a record; it can be deleted and
made again. The pictures are JPEG; measured ones show the shaft, those of an insertion also obstacles, target, plan and
path.

A live view is drawn in a process of its own that reads the record, so no viewer can delay what moves axes. Nothing is
read on while the viewer takes nothing, so memory stays bounded. Of the pictures that wait then, the newest few are
drawn; events and states are never left out.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from labrig.analysis.result import CentreLines
from labrig.clock import Clock
from labrig.durable import disk_errors, require_free_bytes, sync_directory, sync_file, temporary_file
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun, RecordLines, list_lines
from labrig.record.layout import VIEW
from labrig.record.pictures import RecordedPicture
from labrig.record.reader import Run
from labrig.report.event_words import describe_event
from labrig.report.palette import mark
from labrig.report.pictures import JpegSize, jpeg
from labrig.report.view import View
from labrig.report.viewer import RunningViewer
from labrig.vision.picture import size_of

TIME = "rig time"
"""The time line of everything [s]."""
DRIVES, EVENTS, CAMERA = "/drives", "/events", "/camera"

DescribeStatus = Callable[[int], str]
"""Returns what a statusword says of a drive, as one of `_DRIVE_STATES` if it is one."""

_DRIVE_STATES: Mapping[str, int] = {
    "moving": 0x56B4E9FF,
    "holding": 0x009E73FF,
    "power off": 0x808080FF,
    "quick stop": 0xE69F00FF,
    "fault": 0xD55E00FF,
}
"""What a drive does, and its colour."""
_CURVES = (
    ("/depth", "Depth (mm)"),
    ("/roll", "Roll of the rotation axis (degrees)"),
    ("/currents", "Motor currents (mA)"),
)
"""Plots of every run: path and heading."""
_AXES = ("insertion", "rotation", "linear")
# Column of states.jsonl, place and name of its curve, and factor.
_COLUMNS = (
    ("insertion_mm", "/depth/needle", 1.0),
    ("linear_mm", "/depth/sheath", 1.0),
    ("rotation_rad", "/roll/rotation", 180.0 / np.pi),
    *((f"{axis}_current_ma", f"/currents/{axis}", 1.0) for axis in _AXES),
)
_SHAFT_COLOUR, _OLD_COLOUR = (86, 180, 233), (213, 94, 0)
_JPEG_QUALITY = 80
# A needle that has moved back by more than this is not where the last picture shows it [mm].
_BACK_MM = 0.5
# The needle has left the sheath when it stands out this far [mm].
_OUT_MM = 0.5
# Legends stand at the left of the plots: so much of the motion stays free there.
_LEGEND_SHARE = 0.3
# Moves and arrivals are in the log too; the viewer shows them when asked for all levels.
_SHOWN_LEVELS = ("CRITICAL", "ERROR", "WARN", "INFO")
_LIVE_WINDOW_S = 60.0
_MOST_WAITING = 8
"""Pictures that a live view draws of those that wait."""
_TAKES_WITHIN_S, _SENT_WITHIN_S = 1.0, 3.0
# A viewer that takes nothing for this long is reported.
_SLOW_AFTER_S = 10.0


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
    files = {run.path / picture.line.file for picture in run.pictures.places}
    require_free_bytes(run.path, sum(file.stat().st_size for file in files if file.is_file()))
    with disk_errors(path), temporary_file(path) as unfinished:
        # Made here, because rerun does not report a folder that it cannot write either.
        unfinished.touch(exist_ok=False)
        recorded = list_lines(run)
        stream = rr.RecordingStream("labrig", recording_id=run.path.name)
        stream.save(unfinished, default_blueprint=_make_blueprint(view, _find_motion(recorded)))
        try:
            _RecordDrawing(stream, view, describe_status).draw(recorded)
            for line in run.frame_lines if lines else ():
                set_time(stream, line.t_s)
                draw_shaft(stream, [lines[line.frame].px] if line.frame in lines else [])
            view.send(stream, TIME)
        finally:
            stream.disconnect()
        sync_file(unfinished)
        unfinished.replace(path)
        sync_directory(path.parent)
    return path


def show_live(
    run: GrowingRun,
    view: View,
    viewer: RunningViewer,
    describe_status: DescribeStatus,
    *,
    clock: Clock,
    tell: Callable[[str], None],
) -> None:
    """Draw a run that is being made until it has ended or the viewer has; `tell` takes sentences for a person.

    Raises
    ------
    RecordError
        When a line or a picture is damaged.
    """
    stream = rr.RecordingStream("labrig", recording_id=run.path.name)
    stream.connect_grpc(viewer.url)
    # A viewer keeps the layout of the run before, and prefers it to one that is sent as the default.
    stream.send_blueprint(_make_blueprint(view, None))
    drawing = _RecordDrawing(stream, view, describe_status)
    for lines in run.follow(clock):
        chosen = choose_pictures(lines.pictures, view.needs)
        drawing.draw(replace(lines, pictures=chosen))
        if len(chosen) < len(lines.pictures):
            left_out = len(lines.pictures) - len(chosen)
            drawing.remark(
                chosen[-1].line.t_s, f"{left_out} pictures are not shown here; the record has them"
            )
        if not _wait_until_taken(stream, run, viewer, clock, tell):
            break
    # For a viewer that takes nothing rerun would wait without end.
    ending = Thread(target=stream.disconnect, daemon=True)
    ending.start()
    ending.join(_SENT_WITHIN_S)
    if viewer.has_ended():
        tell("the viewer was closed; the run goes on without it")


def choose_pictures(
    waiting: Sequence[RecordedPicture], needs: Callable[[FrameLine], bool], most: int = _MOST_WAITING
) -> list[RecordedPicture]:
    """Return the pictures to draw, in order: the newest `most` of those that wait, and all that are needed."""
    newest = max(0, len(waiting) - most)
    return [picture for index, picture in enumerate(waiting) if index >= newest or needs(picture.line)]


def _wait_until_taken(
    stream: rr.RecordingStream,
    run: GrowingRun,
    viewer: RunningViewer,
    clock: Clock,
    tell: Callable[[str], None],
) -> bool:
    """Return whether the viewer has taken everything; wait for a slow one until the run has ended or it has."""
    from_s, told = clock.now_s(), False
    while not viewer.has_ended():
        try:
            stream.flush(timeout_sec=_TAKES_WITHIN_S)
        except RuntimeError:  # as rerun reports a timeout and a connection that is gone
            if run.has_ended():
                tell("the viewer did not take the end of the run; view.rrd has it")
                return False
            if not told and clock.now_s() > from_s + _SLOW_AFTER_S:
                told = True
                tell(
                    f"the viewer has taken nothing for {_SLOW_AFTER_S:.0f} s; the run goes on without waiting"
                )
        else:
            return True
    return False


def set_time(stream: rr.RecordingStream, t_s: float) -> None:
    """Let what is sent next be of a rig time [s], and of no picture."""
    stream.reset_time()
    stream.set_time(TIME, duration=t_s)


def draw_shaft(stream: rr.RecordingStream, line_px: Sequence[NDArray[np.float64]]) -> None:
    """Draw the centre line (N, 2) of the needle at the stream's time; without one the last line ends."""
    strips = rr.LineStrips2D(list(line_px), colors=[_SHAFT_COLOUR] * len(line_px), radii=1.0)
    stream.log(f"{CAMERA}/shaft", strips)


class _RecordDrawing:
    """Draws what every run has (axes, drive states, events in words, pictures), and what its experiment adds.

    A picture is framed and marked as old once the needle is no longer where it shows it, because it was withdrawn.
    """

    def __init__(self, stream: rr.RecordingStream, view: View, describe_status: DescribeStatus) -> None:
        self._stream, self._view, self._describe_status = stream, view, describe_status
        self._states: dict[str, str] = {}
        self._shown: tuple[FrameLine, tuple[int, int]] | None = None
        """The picture that stands and is not marked as old, and its size."""
        does = list(_DRIVE_STATES)
        style = rr.StateConfiguration(values=does, labels=does, colors=list(_DRIVE_STATES.values()))
        for axis in _AXES:
            stream.log(f"{DRIVES}/{axis}", style, static=True)
        drawn: Counter[str] = Counter()
        for place in (*(place for _, place, _ in _COLUMNS), *view.added):
            # The viewer would choose colours by the name, and give curves of the same plot the same one.
            plot = place.rpartition("/")[0]
            stream.log(place, rr.SeriesLines(colors=[mark(drawn[plot]).rgba]), static=True)
            drawn[plot] += 1

    def draw(self, lines: RecordLines) -> None:
        """Draw lines that follow those drawn before. Raises `RecordError` when a picture is missing or was changed."""
        for name, place, factor in _COLUMNS:
            known = [(state["t_s"], state[name]) for state in lines.states if state.get(name) is not None]
            if known:
                times, values = np.array(known, dtype=np.float64).T
                column = rr.TimeColumn(TIME, duration=times)
                self._stream.send_columns(place, [column], rr.Scalars.columns(scalars=factor * values))
        for event in lines.events:
            entry = describe_event(event, self._view.words)
            self._log(EVENTS, rr.TextLog(entry.text, level=entry.level), _time_of(event))
        told: list[RecordedPicture | Mapping[str, Any]] = [*lines.pictures, *lines.states]
        for line in sorted(told, key=_time_of):
            if isinstance(line, RecordedPicture):
                self._draw_picture(line)
            else:
                self._draw_state(line)
        self._view.follow(self._stream, TIME, lines)

    def remark(self, t_s: float, text: str) -> None:
        """Add a remark of the viewer's own to the log, at a rig time [s]."""
        self._log(EVENTS, rr.TextLog(text, level="WARN"), t_s)

    def _log(self, place: str, drawn: Any, t_s: float) -> None:
        set_time(self._stream, t_s)
        self._stream.log(place, drawn)

    def _draw_state(self, state: Mapping[str, Any]) -> None:
        """Draw what has changed: the state of a drive, and whether the last picture is old."""
        for axis in _AXES:
            statusword = state.get(f"{axis}_statusword")
            does = self._describe_status(statusword) if isinstance(statusword, int) else None
            if does is not None and self._states.get(axis) != does:
                self._states[axis] = does
                self._log(f"{DRIVES}/{axis}", rr.StateChange(state=does), _time_of(state))
        seen_mm = None if self._shown is None else self._shown[0].insertion_mm
        now_mm = state.get("insertion_mm")
        if (
            self._shown is not None
            and seen_mm is not None
            and now_mm is not None
            and now_mm < seen_mm - _BACK_MM
        ):
            width, height = self._shown[1]
            edge = max(2.0, width / 250)
            frame = rr.Boxes2D(mins=[(0.0, 0.0)], sizes=[(width, height)], colors=[_OLD_COLOUR], radii=[edge])
            self._log(f"{CAMERA}/old", frame, _time_of(state))
            label = f"OLD PICTURE: taken at {seen_mm:.1f} mm; the needle has been withdrawn since"
            words = rr.Points2D(
                [(width / 2, height / 20)], labels=[label], colors=[(255, 255, 255)], radii=0.0
            )
            self._log(f"{CAMERA}/old/words", words, _time_of(state))
            self._shown = None

    def _draw_picture(self, picture: RecordedPicture) -> None:
        image = picture.read()
        self._shown = (picture.line, size_of(image))
        set_time(self._stream, picture.line.t_s)
        self._stream.set_time("frame", sequence=picture.line.frame)
        # At full size, because lines are drawn over it in its own pixels. All in colour: once the form of the JPEG
        # changes, as from grey pictures to a plan in colour, the viewer shows none of them any more.
        coloured = image if image.ndim == 3 else np.repeat(image[..., np.newaxis], 3, axis=2)
        content = jpeg(coloured, JpegSize(self._shown[1][0], _JPEG_QUALITY))
        self._stream.log(CAMERA, rr.EncodedImage(contents=content, media_type="image/jpeg"))
        self._stream.log(f"{CAMERA}/old", rr.Clear(recursive=True))


def _make_blueprint(view: View, motion_s: tuple[float, float] | None) -> rrb.Blueprint:
    """Return the layout of the viewer: the camera and the log beside the curves, a plot for each unit.

    Parameters
    ----------
    view : View
        What the experiment adds; it stands first.
    motion_s : (float, float) or None
        Begin and end of what plots show [rig time, s]; None to follow what arrives.
    """
    whole = rr.TimeRange(rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.infinite())
    shown, axis = _make_ranges(motion_s)
    overviews = [_make_plot(*plot, whole, whole) for plot in view.overviews]
    curves = [_make_plot(*plot, shown, axis) for plot in (*view.curves, *_CURVES)]
    drives = rrb.StateTimelineView(origin=DRIVES, name="Drives", time_view=rrb.TimeAxis(view_range=shown))
    log = rrb.TextLogView(
        origin=EVENTS,
        name="Events",
        rows=rrb.TextLogRows(filter_by_log_level=list(_SHOWN_LEVELS)),
        columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
    )
    camera = rrb.Spatial2DView(origin=CAMERA, name="Camera")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(camera, rrb.Horizontal(log, drives, column_shares=[3, 2]), row_shares=[5, 3]),
            rrb.Vertical(*overviews, *curves, row_shares=[*(5 for _ in overviews), *(3 for _ in curves)]),
            column_shares=[3, 2],
        ),
        # At the newest: of a saved run that is its last picture, with the path in it.
        rrb.TimePanel(timeline=TIME, state="collapsed", play_state="following"),
        collapse_panels=True,
    )


def _make_plot(origin: str, name: str, shown: rr.TimeRange, axis: rr.TimeRange) -> rrb.TimeSeriesView:
    data = rrb.VisibleTimeRange(TIME, range=shown)
    return rrb.TimeSeriesView(
        origin=origin, name=name, axis_x=rrb.TimeAxis(view_range=axis), time_ranges=data
    )


def _make_ranges(motion_s: tuple[float, float] | None) -> tuple[rr.TimeRange, rr.TimeRange]:
    """Return what plots show, and their axis, which begins earlier: their legends stand there.

    Shown is the motion or, of a run that is being made, what was just before.
    """
    begin_s, end_s = motion_s or (-_LIVE_WINDOW_S, 0.0)
    early_s = begin_s - _LEGEND_SHARE * (end_s - begin_s)
    place = rr.TimeRangeBoundary.absolute if motion_s else rr.TimeRangeBoundary.cursor_relative
    shown, axis = (rr.TimeRange(place(seconds=t_s), place(seconds=end_s)) for t_s in (begin_s, early_s))
    return shown, axis


def _find_motion(lines: RecordLines) -> tuple[float, float] | None:
    """Return the rig time between which the needle is out of the sheath [s]; None if it never is.

    Of a run with trials, those are meant, and not what was found out before.
    """
    from_s = min((_time_of(event) for event in lines.events if event["kind"] == "trial_start"), default=0.0)
    states: Sequence[Mapping[str, Any]] = lines.states
    out_s = [_time_of(state) for state in states if (state.get("insertion_mm") or 0.0) > _OUT_MM]
    out_s = [t_s for t_s in out_s if t_s >= from_s]
    return (out_s[0], out_s[-1]) if len(out_s) > 1 else None


def _time_of(line: RecordedPicture | Mapping[str, Any]) -> float:
    return line.line.t_s if isinstance(line, RecordedPicture) else float(line["t_s"])
