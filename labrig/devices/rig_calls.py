"""The seam between a procedure and the rig: all that a session asks of a rig, and what it is answered.

Everything above it is the same on a bench, on simulated devices and in a replay; everything below it is theirs. An
opened rig implements it (`labrig.devices.rig`, real or simulated), and so does a record that is replayed
(`labrig.devices.replayed.rig`). What a procedure asks and what it was answered stands once in the record, in order:

=================  ==================================================
asked              answered, and where it stands
=================  ==================================================
`read_states`      a line of states.jsonl
`take_picture`     a picture and its line of frames.jsonl
`start_move`       the event `move`: as asked, and as sent
`ask`              the event `operator`: the question and its answer
`reference_axes`   the event `axes_referenced`
`stop`             the event `axes_stopped`
`truth`            a line of truth.jsonl, of a simulated world
an error of these  the event `run_stop`: the class of the error, its message and fault
=================  ==================================================

Each line has its place in the order of all lines, `seq`, and its time, `t_s`: times are answers too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from labrig.clock import Clock
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.camera import Picture
from labrig.devices.drives.drive import DriveReading, Setpoint
from labrig.devices.needle_state import NeedleState
from labrig.devices.operator import NO_OFFER, Answer, Offer, OperatorRequest
from labrig.devices.rig_file import RigDescription

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture, (H, W) or (H, W, 3) uint8, its rig time [s], and the axis positions at its exposure.

    `t_bound_s` bounds the error of its time [s], and `fraction` is its place between the readings of the encoders
    before and after it, 0 to 1; both are None where the time is that of the call.
    """

    image: Picture
    t_s: float
    positions: AxisPositions
    t_bound_s: float | None = None
    fraction: float | None = None

    def read(self) -> Picture:
        """Return the picture; a rig without a camera draws it now."""
        return self.image

    def paint(self, paint: Callable[[Picture], Picture]) -> Picture:
        """Return the picture with something drawn on it."""
        return paint(self.image)


class RigCalls(Protocol):
    """What a session asks of a rig.

    A rig without devices derives from this and says what it answers; where it says nothing, nothing is done, for
    nothing waits, moves or is lost in it.
    """

    description: RigDescription
    """The rig file."""
    clock: Clock
    """Rig time."""
    needle: NeedleState
    """Where the needle is, its roll zero, and which axes have their reference, across runs."""

    def read_states(self) -> Mapping[str, DriveReading]:
        """Read every axis, all at one instant. Raises `DriveError`, `BusError`, `SafetyStopError`."""

    def take_picture(self) -> Photograph:
        """Take a picture between two readings of the axes. Raises `CameraError`, `DriveError`, `BusError`."""

    def check_move(self, axis_name: str, position: float, speed: float) -> None:
        """Refuse a move that an axis may not make [mm or rad, per s], before anything is sent.

        Raises
        ------
        LimitError
            Names axis, value and limit. A speed is also refused when the whole units of the drive miss it by more than
            the tolerance; that part is left out while gear, lead or encoder are unknown.
        """
        self.description.axes.named(axis_name).check_move(axis_name, position, speed)

    def start_move(self, axis_name: str, position: float, speed: float) -> Setpoint:
        """Start a move [mm or rad, per s] and return at once.

        Raises `LimitError`, `SafetyStopError`, `DriveError`, `BusError`.
        """

    def wait(self, duration_s: float) -> None:
        """Let rig time pass; the axes are supervised. Raises `InterruptedRunError`, `DriveError`, `BusError`."""

    def await_reading(self, axis_name: str | None = None, passing: float | None = None) -> None:
        """Let rig time pass until the axes are to be read again: a period of the recorded states. Raises as `wait`.

        A rig without devices may skip readings until one at which this axis has arrived, or is beyond `passing`.
        """

    def ask(
        self, request: OperatorRequest, offer: Offer = NO_OFFER, also: Callable[[], None] = lambda: None
    ) -> Answer:
        """Let the operator do something; the axes hold still. Raises as `wait`."""

    def do_aside(self, call: Callable[[], _T]) -> _T:
        """Do what may block; the axes are supervised. Raises as `wait`, and what `call` raises."""
        return call()

    def reference_axes(self) -> None:
        """Set the present positions of all axes to zero. Raises `SafetyStopError`, `DriveError`, `BusError`."""

    def assume_positions(self, positions: Mapping[str, float]) -> None:  # noqa: ARG002 - none is lost
        """Assume positions that a person has confirmed [mm or rad]. Raises `DriveError`, `BusError`."""
        return

    def stop(self) -> None:
        """Stop every axis and verify that each stands still. Raises `SafetyStopError`."""
        return

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return the truth of the present insertion, one dict; nothing if it is unknown."""
        return ()

    def take_can_frames(self) -> list[tuple[float, int, bytes, str]]:
        """Return the CAN frames since the last call: rig time [s], COB-ID, data, T or R for sent or received."""
        return []

    def enable(self) -> None:
        """Switch power on; each axis holds its position. Raises `DriveError`, `BusError`."""
        return

    def end(self) -> Mapping[str, DriveReading]:
        """Stop every axis for good, and read where each stands; nothing without axes. Raises `SafetyStopError`."""
        return {}

    def snapshot(self) -> Mapping[str, object]:
        """Return the present state of the devices, ready for JSON."""
        return {}
