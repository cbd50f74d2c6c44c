"""The rig of a record: it answers what the recorded rig answered, and nothing moves."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from labrig.devices.axis_description import AXES
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.drives.drive import DriveReading, Setpoint
from labrig.devices.needle_state import NEW, NeedleState, parse_rig_state
from labrig.devices.operator import NO_OFFER, Answer, Choice, Offer, OperatorRequest
from labrig.devices.replayed.tape import SessionPart, Tape
from labrig.devices.rig_calls import Photograph, RigCalls
from labrig.devices.rig_file import RigDescription, kept_name, load_rig
from labrig.devices.state_line import read_state_line
from labrig.errors import InputError, RecordError
from labrig.plugins import require_devices_installed
from labrig.record.events import Move, OperatorQuestion
from labrig.record.layout import COPY_HINT
from labrig.record.reader import Run

_T = TypeVar("_T")


def load_recorded_rig(run: Run) -> RigDescription:
    """Return the rig of a run, with the calibration that the run holds.

    Raises
    ------
    InputError
        When the run had no rig, or a drive or camera of it is not installed.
    RecordError
        When its rig file is missing or was changed, or a calibration file was changed or added.
    """
    if run.rig_path is None:
        raise InputError(f"{run.path} had no rig", "it moved nothing")
    require_devices_installed(str(run.path), run.plugin_packages)
    description = load_rig(run.rig_path)
    named = {key: value for key, value in description.calibration if value is not None}
    held = {key: f"{key}{Path(value).suffix}" for key, value in named.items()}
    calibration = description.calibration.model_copy(update=held)
    axes = {
        name: axis.model_copy(update={key: kept_name(name, key, path) for key, path in axis.files.items()})
        for name, axis in description.axes.items()
    }
    placed = description.model_copy(
        update={"calibration": calibration, "axes": description.axes.model_copy(update=axes)}
    )
    placed = placed.placed_in(run.own("calibration"))
    for name in placed.calibration_files():
        run.calibration_path(name)  # refuses a file that was changed, or that the run did not begin with
    return placed


@dataclass(frozen=True)
class TapeClock:
    """Rig time of a replay: that of the line that was taken last."""

    tape: Tape
    started: datetime

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return self.tape.t_s

    def sleep(self, duration_s: float) -> None:
        """Do nothing: time passes as the record does."""

    def utc(self) -> datetime:
        """Return the calendar time at which the session was started."""
        return self.started


class ReplayedRig(RigCalls):
    """The rig of a recorded session; see `RigCalls`. What it answers stays the next line until it is recorded.

    Parameters
    ----------
    run : Run
        The record.
    description : RigDescription
        Its rig file.
    part : SessionPart
        The session.
    tape : Tape
        Its lines.

    Raises
    ------
    RecordError
        When the manifest does not say what state the rig was in.
    """

    def __init__(self, run: Run, description: RigDescription, part: SessionPart, tape: Tape) -> None:
        self.description = description
        self.clock = TapeClock(tape, datetime.fromisoformat(part.started))
        self._run = run
        self._tape = tape
        try:
            recorded = part.devices.get("state")
            state = NEW if recorded is None else parse_rig_state(recorded)
        except ValueError as error:
            raise RecordError(
                f"the manifest of {run.path} does not say the state of its rig: {error}", COPY_HINT
            ) from error
        self.needle = NeedleState(None, state)

    def read_states(self) -> Mapping[str, DriveReading]:
        """Return the next recorded reading."""
        line = self._tape.expect("state", "a reading of the axes")
        return self._parse(lambda: read_state_line(self.description, line))

    def take_picture(self) -> Photograph:
        """Return the next recorded picture; its SHA-256 is verified."""
        line = self._tape.expect("frame", "one more picture")
        return self._parse(
            lambda: _parse_photograph(self._run.read_frame(int(line["frame"])), line, self._tape)
        )

    def start_move(self, axis_name: str, position: float, speed: float) -> Setpoint:
        """Return what was sent for the next recorded move, which has to be of this axis."""
        line = self._tape.expect(Move.kind, f"a move of {axis_name} to {position:.6g}")
        if line.get("axis") != axis_name:
            self._tape.differ(f"a move of {axis_name} to {position:.6g}")
        sent = {key: value for key, value in line.items() if key.startswith("sent_")}
        return self._parse(
            lambda: Setpoint(position, speed, float(line["position"]), float(line["speed"]), **sent)
        )

    def wait(self, duration_s: float) -> None:
        """Do nothing: time passes as the record does."""

    def await_reading(self, axis_name: str | None = None, passing: float | None = None) -> None:
        """Do nothing: time passes as the record does."""

    def ask(
        self,
        request: OperatorRequest,
        offer: Offer = NO_OFFER,  # noqa: ARG002 - what was chosen is recorded
        also: Callable[[], None] = lambda: None,  # noqa: ARG002
    ) -> Answer:
        """Return the answer to the next recorded question, which has to be of this kind."""
        line = self._tape.expect(OperatorQuestion.kind, f"question {type(request).__name__}: {request.text}")
        if line.get("request") != type(request).__name__:
            self._tape.differ(f"question {type(request).__name__}: {request.text}")
        return self._parse(lambda: _parse_answer(line))

    def reference_axes(self) -> None:
        """Note that the axes stand at zero."""
        self.needle.update(referenced=AXES, roll_zero=None)

    def _parse(self, read: Callable[[], _T]) -> _T:
        """Return what a line holds. Raises `RecordError` where it lacks a value."""
        try:
            return read()
        except RecordError:
            self._tape.is_over = True
            raise
        except (KeyError, TypeError, ValueError) as error:
            self._tape.is_over, line = True, self._tape.peek()
            what = "line" if line is None else line.what
            raise RecordError(
                f"{self._run.path} cannot be replayed: a {what} at t = {self._tape.total_t_s:.3f} s or after it "
                f"lacks a value: {error}",
                COPY_HINT,
            ) from error


def _parse_photograph(image: Any, line: Mapping[str, Any], tape: Tape) -> Photograph:
    return Photograph(
        image,
        float(line["t_s"]) - (tape.total_t_s - tape.t_s),
        AxisPositions(float(line["insertion_mm"]), float(line["rotation_rad"]), float(line["linear_mm"])),
        line.get("t_bound_s"),
        line.get("fraction"),
    )


def _parse_answer(line: Mapping[str, Any]) -> Answer:
    pixel, choice = line.get("pixel"), line.get("choice")
    return Answer(
        confirmed=bool(line["confirmed"]),
        note=str(line["answer"]),
        reading=line.get("reading"),
        pixel=None if pixel is None else (float(pixel[0]), float(pixel[1])),
        choice=None if choice is None else Choice(choice),
    )
