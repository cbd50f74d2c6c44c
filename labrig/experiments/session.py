"""What every procedure is given, and the four things that it does with it: ask, move, look, note."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Protocol

from labrig.devices import Axis, AxisReadback, OperatorRequest, Rig
from labrig.errors import SafetyStopError
from labrig.record import Journal


class Progress(Protocol):
    """Where a procedure tells how far it has come."""

    def __call__(self, done: float, doing: str) -> None:
        """Take how much of the estimate is behind (rig time [s]; pictures where nothing moves), and a sentence."""
        ...


WhileMoving = Callable[[Mapping[str, AxisReadback]], None]


@dataclass(frozen=True)
class Session:
    """The opened rig, the record of this run, and where progress is told."""

    rig: Rig
    recorder: Journal
    progress: Progress

    def note(self, kind: str, **fields: object) -> None:
        """Append an event, stamped with the rig time."""
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.event(kind, self.rig.clock.now_s(), **fields)

    def ask(self, request: OperatorRequest) -> None:
        """Let the operator do something and confirm it; the axes hold still meanwhile.

        Raises
        ------
        SafetyStopError
            When the operator says no.
        """
        if not self.offer(request):
            raise SafetyStopError(
                f"the operator said no to: {request.text}", "start the run again when it can be confirmed"
            )

    def offer(self, request: OperatorRequest) -> bool:
        """Ask the operator something that may be declined, and return whether it was confirmed."""
        answer = self.rig.ask(request)
        self.note(
            "operator",
            request=type(request).__name__,
            details=asdict(request),
            confirmed=answer.confirmed,
            answer=answer.note,
        )
        return answer.confirmed

    def look(self, role: str, trial: int | None = None) -> int:
        """Take a picture, record it with the positions that the encoders read, and return its number."""
        frame, positions = self.rig.look()
        self.recorder.can_frames(self.rig.take_can_frames())
        return self.recorder.frame(
            frame.image,
            frame.t_s,
            trial=trial,
            role=role,
            insertion_mm=positions["insertion"].position,
            rotation_rad=positions["rotation"].position,
            linear_mm=positions["linear"].position,
        )

    def move(
        self, axis_name: str, position: float, speed: float, while_moving: WhileMoving | None = None
    ) -> None:
        """Move one axis to `position` [mm or rad] at `speed` [per s] and wait until it has arrived.

        The states of all axes are recorded at the rig file's rate until the axis stands in its position window;
        `while_moving` sees each of them.

        Raises
        ------
        LimitError
            Before anything is sent, when the position or speed is beyond the axis' limits.
        DriveError, InterruptedRunError
            From the rig while waiting; the caller's rig stops the axes.
        """
        axis: Axis = getattr(self.rig, axis_name)
        setpoint = axis.start_move(position, speed)
        self.note("move", axis=axis_name, **asdict(setpoint))
        arrived = False
        while not arrived:
            self.rig.wait(self.rig.state_period_s)
            states = self.rig.read_states()
            self._record_states(states)
            if while_moving is not None:
                while_moving(states)
            arrived = states[axis_name].target_reached
        self.note("move_done", axis=axis_name, position=states[axis_name].position)

    def _record_states(self, states: Mapping[str, AxisReadback]) -> None:
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.state(
            self.rig.clock.now_s(),
            insertion_mm=states["insertion"].position,
            rotation_rad=states["rotation"].position,
            linear_mm=states["linear"].position,
            insertion_statusword=states["insertion"].statusword,
            rotation_statusword=states["rotation"].statusword,
            linear_statusword=states["linear"].statusword,
        )
