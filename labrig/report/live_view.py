"""Draws a run into a viewer while it is made, in a process of its own that reads the record.

The record is the queue. Nothing is handed over by the process that moves axes, so no viewer can delay it. Here nothing
is read on while the viewer takes nothing, so memory stays bounded too. Of the pictures that wait then, the newest few
are drawn, the others are counted and left out; events and states are never left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import rerun as rr

from labrig.clock import Clock
from labrig.record.events import FrameLine
from labrig.record.following import GrowingRun, LinedPicture, RecordLines
from labrig.report.record_drawing import TIME, RecordDrawing
from labrig.report.view import View

MOST_WAITING = 8
"""Pictures that are drawn of those that wait."""

_TAKES_WITHIN_S = 1.0
# A viewer that takes nothing for this long is reported.
_SLOW_AFTER_S = 10.0


@dataclass(frozen=True)
class Shown:
    """How many pictures were drawn, and how many left out because drawing was slower than the rig."""

    drawn: int = 0
    left_out: int = 0


def choose_pictures(
    waiting: Sequence[LinedPicture], needs: Callable[[FrameLine], bool], most: int = MOST_WAITING
) -> list[LinedPicture]:
    """Return the pictures to draw, in order: the newest `most` of those that wait, and all that are needed."""
    newest = max(0, len(waiting) - most)
    return [picture for index, picture in enumerate(waiting) if index >= newest or needs(picture.line)]


@dataclass(frozen=True)
class LiveView:
    """A view of a run that is being made.

    Attributes
    ----------
    stream : RecordingStream
        To the viewer.
    drawing : RecordDrawing
        Draws the record into it.
    view : View
        What the experiment adds.
    run : GrowingRun
        The record.
    clock : Clock
        Paces the reading.
    tell : callable
        Takes a sentence for the person at the terminal.
    """

    stream: rr.RecordingStream
    drawing: RecordDrawing
    view: View
    run: GrowingRun
    clock: Clock
    tell: Callable[[str], None]

    def follow(self, has_viewer_ended: Callable[[], bool]) -> Shown:
        """Draw the run until it has ended or the viewer has, and return what was shown.

        Raises
        ------
        RecordError
            When a line or a picture is damaged.
        """
        shown, begins = Shown(), True
        for lines in self.run.follow(self.clock):
            shown, begins = self._draw(lines, shown, begins=begins), False
            if not self._wait_until_taken(has_viewer_ended):
                break
        return shown

    def _draw(self, lines: RecordLines, shown: Shown, *, begins: bool) -> Shown:
        chosen = choose_pictures(lines.pictures, self.view.needs)
        left_out = len(lines.pictures) - len(chosen)
        self.drawing.draw(lines, chosen)
        self.view.follow(self.stream, TIME, RecordLines(lines.events, lines.states, chosen))
        if left_out:
            # A resumed run has pictures already; slow drawing is not to blame for them.
            why = (
                "that were taken before this view began"
                if begins
                else "because drawing was slower than the rig"
            )
            self.drawing.remark(
                chosen[-1].line.t_s, f"left out {left_out} pictures here, {why}; the record has them"
            )
        return Shown(shown.drawn + len(chosen), shown.left_out + (0 if begins else left_out))

    def _wait_until_taken(self, has_viewer_ended: Callable[[], bool]) -> bool:
        """Return whether the viewer has taken everything; wait for a slow one until the run has ended or it has."""
        from_s, told = self.clock.now_s(), False
        while not self._flush():
            if has_viewer_ended():
                return False
            if self.run.has_ended():
                self.tell("the viewer did not take the end of the run; view.rrd has it")
                return False
            if not told and self.clock.now_s() > from_s + _SLOW_AFTER_S:
                told = True
                self.tell(
                    f"the viewer has taken nothing for {_SLOW_AFTER_S:.0f} s; the run goes on without waiting for it"
                )
        return not has_viewer_ended()

    def _flush(self) -> bool:
        """Send everything; return whether it was taken in time."""
        try:
            self.stream.flush(timeout_sec=_TAKES_WITHIN_S)
        except RuntimeError:  # as rerun reports a timeout and a connection that is gone
            return False
        return True
