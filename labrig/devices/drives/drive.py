"""`Drive`, a drive in the units of its axis, and what is done with several at once.

What is decided here
--------------------
- An axis knows no objects, counts or rpm: a drive rounds, and tells what it sent. Positions are those of the axis [mm
  or rad], relative to the zero from homing or `assume_position`.
- What must not depend on the driver stays above it: `Axis` and `Rig` check limits, keep references, send heartbeats and
  stop everything. A drive holds the limits too, and stops by itself when the computer's heartbeat stops.
- Nothing counts until it has been read back. A method that writes a setting reads it back and raises `DriveError` if
  the drive has another value.
- Nothing but `enable` switches power on, and it moves nothing. Nothing but `reset_fault` resets a fault.
- Every method may raise `DriveError` and `BusError`; a `Raises` section below says when.
- A drive can be opened with an incomplete section (an unknown gear): methods that need no conversion still work, so
  that `labrig devices stop` and `check` reach it. The others raise `InputError`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Protocol, TypeVar

from pydantic import Field

from labrig.clock import Clock
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.input_channel import InputValue
from labrig.errors import DriveError, DriveFaultError, MachineError
from labrig.protocol.model import Model

STILL_COUNTS = 2
"""Dither of a servo at rest [counts]."""

STILL_POLL_S = 0.05
"""Time between two readings of a position while waiting for standstill [s]."""


@dataclass(frozen=True)
class Identity:
    """Identity that a drive reports; `versions` are its hardware and software, by their names in a record.

    `serial_number` is None for a drive that has none. `doubt` is what `labrig devices check` warns of, and `unguarded`
    what a person has to confirm before the axis may move; both are phrases, empty without one.
    """

    model: str
    serial_number: int | None
    versions: Mapping[str, int] = field(default_factory=dict)
    doubt: str = ""
    unguarded: str = ""

    def document(self) -> dict[str, object]:
        """Return it ready for JSON."""
        return {"model": self.model, **self.versions, "serial_number": self.serial_number}


@dataclass(frozen=True)
class Setpoint:
    """A move as requested and as sent.

    Parameters
    ----------
    asked_position, asked_speed : float
        What was asked [mm or rad, per s].
    sent : mapping of str to int
        What went over the wire, by the names of its drive.
    position, speed : float
        What that amounts to [mm or rad, per s]; differs by rounding.
    """

    asked_position: float
    asked_speed: float
    sent: Mapping[str, int]
    position: float
    speed: float

    def document(self) -> dict[str, float]:
        """Return it as in an event of the record."""
        asked = {"asked_position": self.asked_position, "asked_speed": self.asked_speed}
        return {**asked, **self.sent, "position": self.position, "speed": self.speed}


@dataclass(frozen=True, slots=True)
class DriveReading:
    """A reading of a drive that can move: position [mm or rad], statusword, and whether its last move has arrived.

    `target_reached` is true if the drive says so and the position is within the window around the target. `inputs` has
    the inputs that the rig file names. The motor current [mA] is in a reading at a SYNC; None
    if the drive does not measure it.
    """

    position: float
    statusword: int
    target_reached: bool
    current_ma: float | None = None
    inputs: Mapping[str, InputValue] = field(default_factory=dict)


class Homing(Model):
    """How an axis gets its reference."""

    method: int = 35
    """Homing method. 35: where it stands, on confirmation."""
    position: float = 0.0
    """What the position is once home is found [mm or rad]."""
    offset: Annotated[float, Field(ge=0)] = 0.0
    """How far to move off the stop or switch before [mm or rad]."""
    speed: Annotated[float, Field(gt=0)] = 1.0
    """Speed of the search [mm/s or rad/s]."""
    timeout_s: Annotated[float, Field(gt=0, le=600)] = 60.0
    """When the search is given up [s]."""


HERE = Homing(timeout_s=1.0)
"""Zero where the axis stands."""


class Drive(Protocol):
    """One drive. Its section of the rig file opens it; that subscribes to its reports, and neither reads nor writes."""

    @property
    def name(self) -> str:
        """Its name in messages, with axis and node."""

    # Connecting

    def identify(self) -> Identity:
        """Return the identity of the drive; nothing is written.

        Raises
        ------
        DriveError
            When it is not the drive of its section: another product, another encoder, changed parameters, or two nodes
            that answer at once. Names all reasons together.
        """

    def configure(self, heartbeat: HeartbeatDescription, max_current_ma: int | None) -> None:
        """Stop the axis, switch power off, write the settings of its section, and make the drive stop by itself.

        From here on the drive sends heartbeats, and `check` notices when they stop. It stops when those of the computer
        do, and obeys no process data of anybody else. Each setting is read, written if it differs, and read back.

        Parameters
        ----------
        heartbeat : HeartbeatDescription
            Period, node id, and the silence after which the drive stops.
        max_current_ma : int or None
            Limit of the output current until `close` [mA]; None keeps its own limit.

        Raises
        ------
        DriveError
            On a fault, on limits of the rig file above the drive's own, and on a setting that it does not keep, among
            them an option that means "no action" on a lost heartbeat.
        """

    def describe(self) -> dict[str, object]:
        """Return conversion and settings of the drive for the record, ready for JSON."""

    # Power

    def enable(self) -> None:
        """Switch power on; the axis holds its position. Raises `DriveError`, also on a fault."""

    def close(self) -> None:
        """Switch power off, restore what `configure` limited, and end both heartbeats without a fault."""

    # Moving

    def position(self) -> float:
        """Return the position of the axis [mm or rad]."""

    def round_move(self, position: float, speed: float) -> Setpoint:
        """Return the nearest move that the drive can make; nothing is sent."""

    def start_move(self, position: float, speed: float) -> None:
        """Start a move to an absolute position [mm or rad, per s] and return once the drive has accepted it.

        It replaces a move in progress.
        """

    def target(self) -> float | None:
        """Return the target position that the drive now has, whoever wrote it [mm or rad]; None if it does not tell."""

    def read(self, since_s: float | None = None) -> DriveReading:
        """Read statusword, position and inputs.

        Parameters
        ----------
        since_s : float or None
            Rig time just before a SYNC [s]: what the drive reports at it is read if it can, with the motor current.

        Raises
        ------
        DriveError
            When the drive cannot move: a fault, a restart, silence, or power off.
        """

    def check(self) -> None:
        """Raise a restart, emergency or silence that was noticed; send nothing to the drive."""

    # Stopping

    def post_stop(self, *, quick: bool = False) -> None:
        """Send a stop, and wait for no answer; a halt only to a drive last known enabled. Raises `BusError`."""

    def stop(self, *, quick: bool = False) -> None:
        """Decelerate and hold, if power is on; this never switches power on.

        A quick stop has its own deceleration, and wakes a node that somebody has stopped; afterwards the drive must be
        enabled again.
        """

    def wait_until_still(self, within_s: float) -> Iterator[None]:
        """Poll the position until the axis stands still; the caller lets `STILL_POLL_S` pass after each reading.

        Raises
        ------
        DriveError
            When it still moves after `within_s`; the slowest speed of the drive counts as moving, if its position
            shows it within 0.4 s.
        """

    # Reference

    def home(self, homing: Homing) -> Iterator[None]:
        """Home, from standstill and enabled, and hold at home, ready for moves; the caller lets time pass at each turn.

        `homing.method` is a key of the section's `homing_directions`.

        This discards the position of `assume_position`.

        Raises
        ------
        DriveError
            When home is not found, or not in time; home found by an earlier homing does not count.
        """

    def is_referenced(self) -> bool:
        """Tell whether the drive still has its reference, which it loses with its power.

        A drive that cannot tell has it until it is closed.
        """

    def assume_position(self, position: float) -> None:
        """Assume that the axis is at this position [mm or rad]; the drive keeps its counter and gets no reference."""

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Make the drive itself stop at these positions, widened by the window [mm or rad]; None removes limits."""

    # Condition

    def faults(self) -> tuple[DriveFaultError, ...]:
        """Return the present faults that the drive reports, the newest first; empty without a fault."""

    def reset_fault(self) -> None:
        """Reset a fault that a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause persists.
        """

    def current_ma(self) -> float | None:
        """Return the motor current, with its sign [mA]; None if the drive does not measure it."""

    def lag(self) -> float | None:
        """Return the following error, with its sign [mm or rad]; None if the drive does not tell it."""

    def current_limit_ma(self) -> int | None:
        """Return the limit of the output current [mA]; None if the drive has none."""

    def set_current_limit(self, limit_ma: int) -> None:
        """Set the drive's own limit of the output current [mA]: a labrig that was killed has left another one."""

    def read_inputs(self) -> Mapping[str, InputValue]:
        """Return what the inputs read that the rig file names, by its names for them."""


_Thing = TypeVar("_Thing")


def raise_together(failures: Sequence[MachineError]) -> None:
    """Raise the first failure with the messages of all; do nothing without failures."""
    if not failures:
        return
    together = failures[0].reword("; ".join(failure.message for failure in failures))
    if len(failures) > 1 and isinstance(together, DriveError):
        together.axis = ""
    raise together


def try_all(things: Iterable[_Thing], action: Callable[[_Thing], object]) -> list[MachineError]:
    """Do something with every one of them, and return the failures: that of one keeps nothing from the others."""
    failures: list[MachineError] = []
    for thing in things:
        try:
            action(thing)
        except MachineError as error:
            failures.append(error)
    return failures


def wait_for_all(waits: Mapping[str, Iterator[None]], clock: Clock) -> dict[str, str]:
    """Wait in parallel until all stand still, and return the errors of those that do not.

    Parameters
    ----------
    waits : mapping of str to iterator
        By name, from `Drive.wait_until_still`.
    clock : Clock
        Lets the time between two readings pass.
    """
    failures: dict[str, str] = {}
    moving = dict(waits)
    while moving:
        for name, wait in tuple(moving.items()):
            try:
                next(wait)
            except StopIteration:
                del moving[name]
            except MachineError as error:
                failures[name] = error.message
                del moving[name]
        if moving:
            clock.sleep(STILL_POLL_S)
    return failures
