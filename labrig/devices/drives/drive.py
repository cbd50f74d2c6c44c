"""What a drive says and is asked in the units of its axis, and what is done with several drives at once.

What is decided here
--------------------
- An axis knows no objects, counts or rpm: a drive rounds, and tells what it sent. Positions are those of the axis [mm
  or rad], relative to the zero from homing or `assume_position`.
- What must not depend on the driver stays above it: `Axis` and `Rig` check limits, keep references, send heartbeats and
  stop everything. A drive holds the limits too, and stops by itself when the computer's heartbeat stops.
- Nothing counts until it has been read back. A method that writes a setting reads it back and raises `DriveError` if
  the drive has another value.
- Nothing but `enable` switches power on, and it moves nothing. Nothing but `reset_fault` resets a fault.
- Every method of a drive may raise `DriveError` and `BusError`; a `Raises` section says when.
- A drive can be opened with an incomplete section (an unknown gear): methods that need no conversion still work, so
  that `labrig devices stop` and `check` reach it. The others raise `InputError`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

from pydantic import Field

from labrig.clock import Clock
from labrig.devices.input_channel import InputValue
from labrig.errors import DriveError, MachineError
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
    position, speed : float
        What was sent amounts to [mm or rad, per s]; differs by rounding.
    sent_counts, sent_speed_units : int or None
        What went over the wire; None on a rig that has none.
    """

    asked_position: float
    asked_speed: float
    position: float
    speed: float
    sent_counts: int | None = None
    sent_speed_units: int | None = None


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


HOMING_HERE = 35
"""Method that makes the present position home, whatever its number in the drive; nothing moves."""


class Homing(Model):
    """How an axis gets its reference."""

    method: int = HOMING_HERE
    """Homing method of the drive. 35: home is the present position, on confirmation. 17, 18: to the negative or
    positive limit switch; 1, 2: the same, then to the index. An EPOS2 finds its stop by current too: -1, -3
    in the motor's positive direction, -2, -4 in its negative one; -1 and -2 then go to the index."""
    position: float = 0.0
    """What the position is once home is found [mm or rad]."""
    offset: Annotated[float, Field(ge=0)] = 0.0
    """How far to move off the stop or switch before [mm or rad]."""
    speed: Annotated[float, Field(gt=0)] = 1.0
    """Speed of the search [mm/s or rad/s]."""
    timeout_s: Annotated[float, Field(gt=0, le=600)] = 60.0
    """When the search is given up [s]."""
    current_threshold_ma: Annotated[int, Field(ge=1, le=65535)] = 500
    """Motor current that counts as having reached the stop, by a method below zero [mA]."""


HERE = Homing(timeout_s=1.0)
"""Zero where the axis stands."""


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
        By name, from `Cia402Drive.wait_until_still`.
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
