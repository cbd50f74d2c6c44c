"""`Drive`, a drive as axis and rig see it, in mm or rad; `DriveKind`, what a package declares to add a kind of drive.

What is decided here
--------------------
- An axis knows no objects, counts or rpm: a drive rounds, and says what it sent. Positions are those of the axis [mm or
  rad], counted from where homing, or `assume_position`, put them.
- What must not depend on the driver stays above it: `Axis` and `Rig` check limits, keep references, send heartbeats and
  stop everything. A drive holds the limits too, and stops by itself when the computer's heartbeat stops.
- Nothing is believed that has not been read back. A method that writes a setting reads it back and raises `DriveError`
  where the drive has kept another value.
- Nothing but `enable` switches power on, and it moves nothing. Nothing but `reset_fault` resets a fault.
- Every method may raise `DriveError` and `BusError`; where that is said further down, it is about when.
- A drive is opened with an incomplete section too (an unknown gear): what needs no conversion works all the same, so
  that `labrig devices stop` and `check` reach it. What needs one raises `InputError`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from labrig.clock import Clock
from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.canopen_objects import Entry
from labrig.devices.check_result import CheckResult
from labrig.devices.cia402_states import DriveState
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.simulated.simulated_node import SimulatedNode
from labrig.errors import DriveFaultError, InputError, MachineError, PluginError
from labrig.plugins import DRIVES, INTERFACE, find_plugin

DEFAULT_DRIVER = "epos2"
"""Kind of drive of an axis section that names none, as those of older rig files do."""

STILL_LOOK_S = 0.05
"""Time between two looks at a position until it stands still [s]."""


@dataclass(frozen=True)
class Identity:
    """What a drive says it is; `versions` are its hardware and software, by the names that a record gives them.

    `serial_number` is None for a drive that has none.
    """

    model: str
    serial_number: int | None
    versions: Mapping[str, int] = field(default_factory=dict)

    def document(self) -> dict[str, object]:
        """Return it ready for JSON."""
        return {"model": self.model, **self.versions, "serial_number": self.serial_number}


@dataclass(frozen=True)
class RoundedMove:
    """The move that a drive can make nearest to the one asked.

    Parameters
    ----------
    position, speed : float
        Where to and how fast [mm or rad, per s].
    sent : mapping of str to int
        What goes over the wire, by the names that the record gives it.
    """

    position: float
    speed: float
    sent: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class DriveReading:
    """What a drive read: position [mm or rad], statusword, its state, and whether its last move has arrived.

    `target_reached` is true where the drive says so and the position stands within the window around the target.
    """

    position: float
    statusword: int
    state: DriveState
    target_reached: bool


@dataclass(frozen=True)
class Homing:
    """One homing.

    Parameters
    ----------
    method : int
        A key of the section's `homing_directions`; `HOMING_HERE` takes the position where the axis stands.
    position : float
        What the position is once home is found [mm or rad].
    offset : float
        How far to move off the switch or stop before, without sign [mm or rad].
    speed : float
        Speed of the search [mm/s or rad/s].
    timeout_s : float
        When the search is given up [s].
    """

    method: int
    position: float = 0.0
    offset: float = 0.0
    speed: float = 1.0
    timeout_s: float = 1.0


class Drive(Protocol):
    """One drive. A `DriveKind` opens it; opening subscribes to what the drive reports, and asks and writes nothing."""

    @property
    def name(self) -> str:
        """What messages call it, with axis and node."""

    # Connecting

    def identify(self) -> Identity:
        """Return what the drive is; nothing is written.

        Raises
        ------
        DriveError
            When it is not the drive of its section: another product, another encoder, changed parameters, or two nodes
            that answer at once. All reasons are named together.
        """

    def cob_ids(self) -> tuple[frozenset[int], frozenset[int]]:
        """Return the COB-IDs of process data that the drive sends, and that it obeys: no two drives share one."""

    def configure(self, heartbeat: HeartbeatDescription, max_current_ma: int | None) -> None:
        """Stop what moves, switch power off, and give the drive the settings of its section and the dead-man.

        From here on the drive beats, and `check` notices when it falls silent.

        Parameters
        ----------
        heartbeat : HeartbeatDescription
            How often, as which node, and after which silence the drive stops.
        max_current_ma : int or None
            Output current that the drive does not exceed until `close` [mA]; None leaves its own limit.

        Raises
        ------
        DriveError
            On a fault, a setting that the drive does not keep, and a current limit that it does not have.
        """

    def settings(self) -> Mapping[str, int]:
        """Return what each setting was asked to be, by its place in the manual; `configure` has read back the same."""

    def verify_dead_man(self, heartbeat: HeartbeatDescription) -> None:
        """Let the drive stop by itself when the computer falls silent: read, write where it differs, read back.

        Raises
        ------
        DriveError
            When the drive does not keep it.
        """

    def describe(self) -> dict[str, object]:
        """Return how the drive converts and is set, for the record, ready for JSON."""

    def counts(self) -> dict[str, int]:
        """Return how often it had to be asked again, `retries`, and its answers that nobody asked for, `strays`."""

    # Power

    def enable(self) -> None:
        """Switch power on; the axis holds where it stands. Raises `DriveError`, also on a fault."""

    def disable(self) -> None:
        """Switch power off."""

    def close(self) -> None:
        """Switch power off, take back what `configure` limited, and let both heartbeats end, which is no fault."""

    # Moving

    def position(self) -> float:
        """Return where the axis stands [mm or rad]."""

    def round_move(self, position: float, speed: float) -> RoundedMove:
        """Return the move that the drive can make nearest to this one; nothing is sent."""

    def start_move(self, position: float, speed: float) -> None:
        """Start a move to an absolute position [mm or rad, per s] and return once the drive has taken it.

        It replaces a move that is under way.
        """

    def expect_report(self) -> None:
        """Let the next `read` return what the drive reports at the SYNC about to be sent, where it can do so."""

    def read(self) -> DriveReading:
        """Read statusword and position.

        Raises
        ------
        DriveError
            When the drive cannot move: a fault, a restart, silence, power that is off.
        """

    def check(self) -> None:
        """Raise the restart, emergency or silence that has been noticed; ask the drive nothing."""

    # Stopping

    def send_stop(self) -> None:
        """Tell a drive that was enabled when it was last heard to stop, and wait for no answer. Raises `BusError`."""

    def stop(self) -> None:
        """Decelerate and hold, if there is power; power is never switched on by this."""

    def quick_stop(self) -> None:
        """Stop with the quick stop deceleration; afterwards the drive must be enabled again."""

    def wait_until_still(self, within_s: float) -> Iterator[None]:
        """Look until the axis stands still, as its position reads; the caller lets `STILL_LOOK_S` pass after each look.

        Raises
        ------
        DriveError
            When it still moves after `within_s`; the slowest speed that the drive can be told counts as moving, as
            far as its position tells within 0.4 s.
        """

    # Reference

    def start_homing(self, homing: Homing) -> None:
        """Begin to look for home, from standstill and enabled; what `assume_position` said is forgotten."""

    def has_homed(self) -> bool:
        """Tell whether home has been found since `start_homing`.

        Raises
        ------
        DriveError
            When it cannot be found, or not in time; one that an earlier homing found does not count.
        """

    def finish_homing(self, homing: Homing) -> None:
        """Hold at home, ready for moves."""

    def is_referenced(self) -> bool:
        """Tell whether the drive has kept its reference since it was set; lost with its power.

        One that does not tell has it until it is closed.
        """

    def assume_position(self, position: float) -> None:
        """Take the axis to stand at this position [mm or rad]; the drive keeps its counter and gets no reference."""

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Let the drive itself stop at these positions, wider by the window [mm or rad]; None takes limits off."""

    # Condition

    def faults(self) -> tuple[DriveFaultError, ...]:
        """Return the faults in which the drive is, the newest first, as far as it tells them; none when in none."""

    def reset_fault(self) -> None:
        """Reset a fault, as a person has confirmed; power stays off and nothing moves.

        Raises
        ------
        DriveFaultError
            When the cause is still there.
        """

    def current_ma(self) -> float | None:
        """Return the motor current, with its sign [mA]; None where the drive does not measure it."""

    def current_limit_ma(self) -> int | None:
        """Return the output current that the drive does not exceed [mA]; None where it has no such limit."""

    def inputs(self) -> Mapping[str, bool]:
        """Return its digital inputs by name, true where active: `negative-limit`, `positive-limit`, `home`, others."""


Section = TypeVar("Section", bound=AxisDescription)


@dataclass(frozen=True)
class DriveKind(Generic[Section]):
    """A kind of drive; what an entry point of the group `labrig.drives` names.

    Parameters
    ----------
    name : str
        As `driver:` in a rig file names it, and as the entry point is called.
    settings : type of AxisDescription
        The model of an axis section in a rig file with this driver.
    open : callable
        (link, section, name of the axis, clock) -> Drive.
    check : callable
        (link, section, name of the axis, clock, heartbeat) -> results of `labrig devices check`; writes nothing and
        raises no `LabrigError`.
    find_object : callable
        (section, index, subindex) -> the entry of the drive's object dictionary, None where it is not known; by it
        a replay says in words what passed.
    simulated_node : callable or None
        (section, wire, clock, mechanics, boot time [s]) -> a simulated drive on the wire. None where there is none: a
        simulated rig refuses this kind then.
    example : callable or None
        Node id -> a section for a simulated drive that stands on a bus for itself; with `simulated_node`.
    interface : int
        Version of this interface that the kind is written for.
    """

    name: str
    settings: type[Section]
    open: Callable[[CanLink, Section, str, Clock], Drive]
    check: Callable[[CanLink, Section, str, Clock, HeartbeatDescription], Iterable[CheckResult]]
    find_object: Callable[[Section, int, int], Entry | None]
    simulated_node: Callable[[Section, InProcessWire, Clock, Mechanics, float], SimulatedNode] | None = None
    example: Callable[[int], Section] | None = None
    interface: int = INTERFACE

    def simulate(
        self,
        section: Section,
        wire: InProcessWire,
        clock: Clock,
        mechanics: Mechanics,
        boot_time_s: float = 0.0,
    ) -> SimulatedNode:
        """Return a simulated drive on a wire.

        Raises
        ------
        InputError
            When this kind has none.
        """
        if self.simulated_node is None:
            raise self._without_simulation()
        return self.simulated_node(section, wire, clock, mechanics, boot_time_s)

    def example_section(self, node_id: int) -> Section:
        """Return a section for a simulated drive that stands on a bus for itself. Raises `InputError` as `simulate`."""
        if self.example is None:
            raise self._without_simulation()
        return self.example(node_id)

    def _without_simulation(self) -> InputError:
        return InputError(
            f"drives of kind {self.name} cannot be simulated", "choose another driver, or a rig of kind bench"
        )


def find_drive_kind(name: str) -> DriveKind[Any]:
    """Return the kind of drive that rig files call by this name.

    Raises
    ------
    InputError
        When no installed package has one, or several do.
    PluginError
        When its package cannot be imported or is written for another interface.
    """
    plugin = find_plugin(DRIVES, name)
    kind = plugin.load()
    if not isinstance(kind, DriveKind):
        raise PluginError(
            f"{plugin} is a {type(kind).__name__}, expected a DriveKind", "see labrig.devices.drive"
        )
    return kind


def open_drive(link: CanLink, section: AxisDescription, axis: str, clock: Clock) -> Drive:
    """Return the drive of an axis, of the kind that its section names."""
    return find_drive_kind(section.driver).open(link, section, axis, clock)


def raise_together(failures: Sequence[MachineError]) -> None:
    """Raise the first failure with the messages of all, if there are any."""
    if failures:
        raise failures[0].reword("; ".join(failure.message for failure in failures))


def wait_for_all(waits: Mapping[str, Iterator[None]], clock: Clock) -> dict[str, str]:
    """Wait at the same time until all stand still, and return what is wrong with those that do not.

    Parameters
    ----------
    waits : mapping of str to iterator
        By name, as `Drive.wait_until_still` has them.
    clock : Clock
        Lets the time between two looks pass.
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
            clock.sleep(STILL_LOOK_S)
    return failures
