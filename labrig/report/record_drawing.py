"""Draws lines of a record into a rerun stream: of a finished run all at once, of a running one as they are written."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from heapq import merge
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from labrig.record.following import LinedPicture, RecordLines
from labrig.report.event_words import describe_event
from labrig.report.palette import mark
from labrig.report.pictures import JpegSize, jpeg
from labrig.report.view import View
from labrig.vision.picture import size_of

TIME = "rig_time"
"""The time line of everything [s]."""
_FRAME = "frame"

DescribeStatus = Callable[[int], str]
"""Returns what a statusword says of a drive, as one of `DRIVE_STATES` if it is one."""

DRIVE_STATES: Mapping[str, int] = {
    "moving": 0x56B4E9FF,
    "holding": 0x009E73FF,
    "power off": 0x808080FF,
    "quick stop": 0xE69F00FF,
    "fault": 0xD55E00FF,
}
"""What a drive does, and its colour."""

CURVES = (
    ("/depth", "Depth (mm)"),
    ("/roll", "Roll of the rotation axis (degrees)"),
    ("/currents", "Motor currents (mA)"),
)
"""Plots of every run: path and heading."""

DRIVES, EVENTS, CAMERA = "/drives", "/events", "/camera"

_AXES = ("insertion", "rotation", "linear")
# Column of states.jsonl, place and name of its curve, and factor.
_COLUMNS = (
    ("insertion_mm", "/depth/needle", 1.0),
    ("linear_mm", "/depth/sheath", 1.0),
    ("rotation_rad", "/roll/rotation", 180.0 / np.pi),
    *((f"{axis}_current_ma", f"/currents/{axis}", 1.0) for axis in _AXES),
)
_SHAFT_COLOUR = (86, 180, 233)
_OLD_COLOUR, _WHITE = (213, 94, 0), (255, 255, 255)
_QUALITY = 80
# A needle that has moved back by more than this is not where the last picture shows it [mm].
_BACK_MM = 0.5

_LEVELS = {
    "ERROR": rr.TextLogLevel.ERROR,
    "WARN": rr.TextLogLevel.WARN,
    "INFO": rr.TextLogLevel.INFO,
    "DEBUG": rr.TextLogLevel.DEBUG,
}


def draw_shaft(stream: rr.RecordingStream, line_px: Sequence[NDArray[np.float64]]) -> None:
    """Draw the centre line (N, 2) of the needle at the stream's time; without one the last line ends."""
    strips = rr.LineStrips2D(list(line_px), colors=[_SHAFT_COLOUR] * len(line_px), radii=1.0)
    stream.log(f"{CAMERA}/shaft", strips)


def set_time(stream: rr.RecordingStream, t_s: float) -> None:
    """Let what is sent next be of a rig time [s], and of no picture."""
    stream.reset_time()
    stream.set_time(TIME, duration=t_s)


def choose_colours(added: Sequence[str]) -> dict[str, int]:
    """Return the colour (0xRRGGBBAA) of each curve of a record, and of those added to it, by its place.

    The viewer would choose them by the name, and give curves of the same plot the same colour.
    """
    drawn: Counter[str] = Counter()
    colours = {}
    for place in (*(place for _, place, _ in _COLUMNS), *added):
        plot = place.rpartition("/")[0]
        colours[place] = mark(drawn[plot]).rgba
        drawn[plot] += 1
    return colours


class RecordDrawing:
    """Draws what every run has: axes, drive states, events in words, and pictures.

    A picture is framed and marked as old once the needle is no longer where it shows it, because it was withdrawn.

    Parameters
    ----------
    stream : RecordingStream
        Where to draw.
    view : View
        What the experiment adds: the sentences of its own events, and curves.
    describe_status : callable
        What a statusword says.
    """

    def __init__(self, stream: rr.RecordingStream, view: View, describe_status: DescribeStatus) -> None:
        self._stream = stream
        self._words = view.words
        self._describe_status = describe_status
        self._states: dict[str, str] = {}
        self._picture: LinedPicture | None = None
        self._size = (0, 0)
        self._is_marked = False
        values = list(DRIVE_STATES)
        style = rr.StateConfiguration(values=values, labels=values, colors=list(DRIVE_STATES.values()))
        for axis in _AXES:
            stream.log(f"{DRIVES}/{axis}", style, static=True)
        for place, colour in choose_colours(view.added).items():
            stream.log(place, rr.SeriesLines(colors=[colour]), static=True)

    def draw(self, lines: RecordLines, pictures: Sequence[LinedPicture]) -> None:
        """Draw lines that follow those drawn before.

        Parameters
        ----------
        lines : RecordLines
            Their events and states are all drawn.
        pictures : sequence of LinedPicture
            Those of their pictures that are to be drawn.

        Raises
        ------
        RecordError
            When a picture is missing or was changed.
        """
        self._draw_columns(lines.states)
        for event in lines.events:
            self._draw_event(event)
        ordered = merge(
            ((picture.line.t_s, 0, index) for index, picture in enumerate(pictures)),
            ((_time_of(state), 1, index) for index, state in enumerate(lines.states)),
        )
        for _, is_state, index in ordered:
            if is_state:
                self._draw_state(lines.states[index])
            else:
                self._draw_picture(pictures[index])

    def remark(self, t_s: float, text: str) -> None:
        """Add a remark of the viewer's own to the log, at a rig time [s]."""
        set_time(self._stream, t_s)
        self._stream.log(EVENTS, rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def _draw_columns(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Send the readings of the axes, a column for each; old records have no currents."""
        for name, place, factor in _COLUMNS:
            known = [(state["t_s"], state[name]) for state in states if state.get(name) is not None]
            if known:
                times, values = np.array(known, dtype=np.float64).T
                self._stream.send_columns(
                    place,
                    [rr.TimeColumn(TIME, duration=times)],
                    rr.Scalars.columns(scalars=factor * values),
                )

    def _draw_event(self, event: Mapping[str, Any]) -> None:
        entry = describe_event(event, self._words)
        set_time(self._stream, _time_of(event))
        self._stream.log(EVENTS, rr.TextLog(entry.text, level=_LEVELS[entry.level]))

    def _draw_state(self, state: Mapping[str, Any]) -> None:
        """Draw what has changed: the state of a drive, and whether the last picture is old."""
        for axis in _AXES:
            statusword = state.get(f"{axis}_statusword")
            if isinstance(statusword, int):
                self._draw_drive(axis, self._describe_status(statusword), _time_of(state))
        if self._picture is None or self._is_marked:
            return
        seen_mm, now_mm = self._picture.line.insertion_mm, state.get("insertion_mm")
        if seen_mm is not None and now_mm is not None and now_mm < seen_mm - _BACK_MM:
            self._mark_as_old(seen_mm, _time_of(state))

    def _draw_drive(self, axis: str, does: str, t_s: float) -> None:
        if self._states.get(axis) == does:
            return
        self._states[axis] = does
        set_time(self._stream, t_s)
        self._stream.log(f"{DRIVES}/{axis}", rr.StateChange(state=does))

    def _mark_as_old(self, seen_mm: float, t_s: float) -> None:
        self._is_marked = True
        width, height = self._size
        label = f"OLD PICTURE: taken at {seen_mm:.1f} mm; the needle has been withdrawn since"
        set_time(self._stream, t_s)
        frame = rr.Boxes2D(
            mins=[(0.0, 0.0)],
            sizes=[(width, height)],
            colors=[_OLD_COLOUR],
            radii=[max(2.0, width / 250)],
        )
        self._stream.log(f"{CAMERA}/old", frame)
        words = rr.Points2D([(width / 2, height / 20)], colors=[_WHITE], labels=[label], radii=0.0)
        self._stream.log(f"{CAMERA}/old/words", words)

    def _draw_picture(self, picture: LinedPicture) -> None:
        image = picture.read()
        self._picture, self._size = picture, size_of(image)
        set_time(self._stream, picture.line.t_s)
        self._stream.set_time(_FRAME, sequence=picture.line.frame)
        # At full size, because lines are drawn over it in its own pixels.
        content = jpeg(image, JpegSize(self._size[0], _QUALITY))
        self._stream.log(CAMERA, rr.EncodedImage(contents=content, media_type="image/jpeg"))
        if self._is_marked:
            self._stream.log(f"{CAMERA}/old", rr.Clear(recursive=True))
            self._is_marked = False


def _time_of(line: Mapping[str, Any]) -> float:
    return float(line["t_s"])
