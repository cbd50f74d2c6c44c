"""What every procedure works with: it asks the operator, moves axes, takes pictures and records events."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from labrig.devices.axis import AxisReadback
from labrig.devices.operator import Answer, OperatorRequest, request_details
from labrig.devices.rig import Rig
from labrig.errors import SafetyStopError
from labrig.record.events import Event, Move, MoveDone, OperatorQuestion, PictureRole
from labrig.record.layout import picture_file
from labrig.record.sink import RecordSink
from labrig.runner.axis_positions import AxisPositions, collect_axis_positions
from labrig.vision.picture import Picture


class Progress(Protocol):
    """Receives the progress of a procedure."""

    def __call__(self, done: float, doing: str) -> None:
        """Receive how much of the estimate is done (rig time [s]; pictures if nothing moves), and a sentence."""
        ...


_T = TypeVar("_T")

WhileMoving = Callable[[Mapping[str, AxisReadback]], None]


@dataclass(frozen=True, eq=False)
class TakenPicture:
    """A recorded picture: its number, the picture, and the axis positions at its exposure."""

    frame: int
    image: Picture
    positions: AxisPositions


@dataclass(frozen=True)
class Session:
    """The opened rig, the record of this run, and the receiver of progress."""

    rig: Rig
    recorder: RecordSink
    progress: Progress

    def record(self, event: Event) -> None:
        """Append an event, stamped with the rig time."""
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.record_event(event, self.rig.clock.now_s())

    def ask(self, request: OperatorRequest) -> Answer:
        """Ask the operator to do and confirm something, and return the answer; the axes hold still meanwhile.

        Raises
        ------
        SafetyStopError
            When the operator does not confirm.
        """
        answer = self._ask_operator(request)
        if not answer.confirmed:
            raise SafetyStopError(
                f"the operator said no to: {request.text}", "start the run again when it can be confirmed"
            )
        return answer

    def offer(self, request: OperatorRequest) -> bool:
        """Ask the operator for something optional, and return whether it was confirmed."""
        return self._ask_operator(request).confirmed

    def _ask_operator(self, request: OperatorRequest) -> Answer:
        answer = self.rig.ask(request)
        self.record(
            OperatorQuestion(
                request=type(request).__name__,
                details=request_details(request, self.recorder.path),
                confirmed=answer.confirmed,
                answer=answer.note,
                reading=answer.reading,
                pixel=answer.pixel,
            )
        )
        return answer

    def take_picture(self, role: PictureRole, trial: int | None = None) -> TakenPicture:
        """Take a picture, record it with the axis positions at its exposure, and return it.

        The exposure lies between two readings of the encoders. The positions are interpolated to the time of the camera
        or, without one, half-way. At 1 mm/s their error is a few hundredths of a millimetre.
        """
        before = collect_axis_positions(self.rig.read_states())
        frame, states = self.rig.take_picture()
        positions = before.interpolate_to(
            collect_axis_positions(states), 0.5 if frame.fraction is None else frame.fraction
        )
        self.recorder.can_frames(self.rig.take_can_frames())
        known = {**frame.time_fields(), **asdict(positions)}
        number = self.recorder.frame(frame.image, frame.t_s, trial=trial, role=role, **known)
        return TakenPicture(number, frame.image, positions)

    def compute(self, call: Callable[[], _T]) -> _T:
        """Return what takes long to compute, or to read from a file; the axes are supervised meanwhile.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """
        return self.rig.do_aside(call)

    def draw(self, image: Picture, role: PictureRole, trial: int | None = None) -> Path:
        """Record a picture with a drawing on it, and return its file."""
        number = self.recorder.frame(image, self.rig.clock.now_s(), trial=trial, role=role, drawn=True)
        return self.picture_path(number)

    def picture_path(self, frame: int) -> Path:
        """Return the file of a recorded picture."""
        return self.recorder.path / picture_file(frame)

    def move(
        self, axis_name: str, position: float, speed: float, while_moving: WhileMoving | None = None
    ) -> None:
        """Move one axis to `position` [mm or rad] at `speed` [per s] and wait until it has arrived.

        The states of all axes are recorded at the rig file's rate until the axis is in its position window.
        `while_moving` receives each of them.

        Raises
        ------
        LimitError
            Before anything is sent, when the position or speed is beyond the axis' limits.
        DriveError, InterruptedRunError
            From the rig while waiting; the caller's rig stops the axes.
        """
        self.start(axis_name, position, speed)
        arrived = False
        while not arrived:
            states = self.record_next_states()
            if while_moving is not None:
                while_moving(states)
            arrived = states[axis_name].target_reached
        self.record(MoveDone(axis=axis_name, position=states[axis_name].position))

    def start(self, axis_name: str, position: float, speed: float) -> None:
        """Start a move and return at once; an axis in motion continues to the new position without a stop.

        Raises
        ------
        LimitError, SafetyStopError, DriveError, BusError
        """
        setpoint = self.rig.axis(axis_name).start_move(position, speed)
        self.record(Move(axis=axis_name, **setpoint.document()))

    def record_next_states(self) -> Mapping[str, AxisReadback]:
        """Wait for one period of the recorded states, record the states of all axes, and return them.

        Raises
        ------
        DriveError, BusError, InterruptedRunError
            All axes have been stopped.
        """
        self.rig.wait(self.rig.state_period_s)
        states = self.rig.read_states()
        self._record_states(states)
        return states

    def _record_states(self, states: Mapping[str, AxisReadback]) -> None:
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.state(self.rig.clock.now_s(), **_state_fields(self.rig, states))


def _state_fields(rig: Rig, states: Mapping[str, AxisReadback]) -> dict[str, object]:
    """Return the fields of a state line: positions, statuswords, motor currents [mA], then the inputs by their names.

    A rig that replays a record of before reads neither currents nor inputs.
    """
    columns = {axis.name: f"{axis.name}_{axis.unit}" for axis in rig.axes}
    fields: dict[str, object] = {columns[name]: state.position for name, state in states.items()}
    fields |= {f"{name}_statusword": state.statusword for name, state in states.items()}
    if rig.reads_load:
        fields |= {f"{name}_current_ma": state.current_ma for name, state in states.items()}
    for axis in rig.axes:
        channels = axis.description.inputs
        inputs = states[axis.name].inputs
        fields |= {channels[name].column(name): value for name, value in inputs.items()}
    return fields
