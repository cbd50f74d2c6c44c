"""Rigs, drives and people that the tests of this room start from; the drives are simulated nodes on a bus."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType

from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import STILL_POLL_S, Homing
from labrig.devices.drives.epos2 import DRIVE, Epos2Axis
from labrig.devices.drives.objects import Place
from labrig.devices.hardware import Hardware
from labrig.devices.opening import WHOLE, Opening
from labrig.devices.operator import NO_OFFER, Answer, Offer, OperatorRequest
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.simulated.bus import InProcessWire, attach
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.simulated.shaft import Mechanics
from tests.small_camera import CALIBRATED_SMALL_CAMERA

CALIBRATION = Path(__file__).parents[2] / "calibration"
SIMULATED = CALIBRATION / "rig-simulated.yaml"
BENCH = CALIBRATION / "rig-bench.yaml"

ANSWER_TIMEOUT_S = 0.12
HEARTBEAT = HeartbeatDescription()
FAST_WORLD = ("world.bubbles_per_specimen=0", "world.noise_sd=0")


@cache
def simulated_rig(*overrides: str) -> RigDescription:
    """Return the simulated rig, with a small camera and a world that is quick to draw."""
    return load_rig(SIMULATED, (*FAST_WORLD, *CALIBRATED_SMALL_CAMERA, *overrides))


@cache
def large_rig(*overrides: str) -> RigDescription:
    """Return the simulated rig with the camera of its file, 1280x720, for tests of what is measured."""
    return load_rig(SIMULATED, (*FAST_WORLD, *overrides))


def rig_text(old: str, new: str) -> str:
    """Return the text of the simulated rig's file with a stretch replaced where it stands first."""
    text = SIMULATED.read_text(encoding="utf-8")
    assert old in text
    return text.replace(old, new, 1)


def epos2_axis(**changes: object) -> Epos2Axis:
    """Return the section of the simulated insertion axis, 4000 quadcounts a mm, with changes."""
    axis = simulated_rig().axes.insertion.model_copy(update=changes)
    assert isinstance(axis, Epos2Axis)
    return axis


@dataclass
class Person:
    """Somebody at the bench who always answers the same, and remembers what was asked."""

    yes: bool = True
    asked: list[OperatorRequest] = field(default_factory=list)

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer."""
        self.asked.append(request)
        return Answer(self.yes)


def count_repeats(drive: Cia402Drive) -> int:
    """Return how many requests were repeated and answers unexpected, as the record has it."""
    found = drive.describe()
    return sum(int(str(found[key])) for key in ("retries", "strays"))


class Signal:
    """A signal that arrives when a test says so."""

    def __init__(self) -> None:
        self.name: str | None = None

    def __call__(self) -> str | None:
        """Return the signal that has arrived."""
        return self.name


def instants(drive: SimulatedCia402Drive, what: str) -> list[float]:
    """Return when a simulated drive did something, by its journal [s]."""
    return [t_s for t_s, did in tuple(drive.journal) if did.startswith(what)]


FREE, WALLS = Mechanics(), Mechanics(-20_000.0, 20_000.0, -8_000.0, 8_000.0)


@dataclass
class OneDrive:
    """A driver, the simulated drive that it talks to, and their bus."""

    clock: SimulatedClock
    wire: InProcessWire
    link: CanLink
    drive: SimulatedCia402Drive
    driver: Cia402Drive

    def get_ready(self) -> None:
        """Configure and enable the drive."""
        self.driver.identify()
        self.driver.configure(HEARTBEAT, None)
        self.driver.enable()

    def home(self, homing: Homing) -> None:
        """Home to the end."""
        for _ in self.driver.home(homing):
            self.clock.sleep(0.005)

    def settle(self, within_s: float) -> None:
        """Wait until the axis stands still."""
        for _ in self.driver.wait_until_still(within_s):
            self.clock.sleep(STILL_POLL_S)

    def values(self, *places: Place) -> tuple[int, ...]:
        """Return what objects of the drive hold."""
        return tuple(map(self.drive.objects.value, places))

    def reopen(self, **changes: object) -> Cia402Drive:
        """Return another driver, with changes in its section."""
        return Cia402Drive(self.link, self.driver.section.model_copy(update=changes), "insertion", self.clock)


@contextmanager
def one_drive(
    section: AxisDescription | None = None,
    told: AxisDescription | None = None,
    mechanics: Mechanics | None = None,
    fixed: Mapping[Place, int] = MappingProxyType({}),
) -> Iterator[OneDrive]:
    """Set up a drive on a bus, with a driver; `told` is the driver's section, if it is another than the drive's."""
    clock, wire = SimulatedClock(), InProcessWire()
    link = attach(wire, clock, ANSWER_TIMEOUT_S)
    default = FREE if section is None else WALLS
    drive = SimulatedCia402Drive(section or DRIVE.example(1), wire, clock, mechanics or default)
    for place, value in fixed.items():
        drive.objects.set_fixed(place, value)
    clock.on_advance(drive.tick)
    driver = Cia402Drive(link, told or section or epos2_axis(), "insertion", clock)
    yield OneDrive(clock, wire, link, drive, driver)
    link.close()
    drive.unplug()


@dataclass
class OpenedRig:
    """A rig whose simulated hardware a test can reach behind its back."""

    rig: Rig
    hardware: SimulatedHardware
    signal: Signal
    person: Person

    @property
    def drives(self) -> dict[str, SimulatedCia402Drive]:
        """The simulated EPOS2 of each axis."""
        return self.hardware.drives


def make_rig(
    description: RigDescription,
    hardware: Hardware,
    opening: Opening = WHOLE,
    person: Person | None = None,
    signal: Signal | None = None,
) -> Rig:
    """Return a rig over a hardware, not yet connected."""
    return Rig(
        description, hardware=hardware, link=hardware.open_link(),
        source=hardware.open_source() if opening.camera else None,
        person=hardware.accompany(person or Person()), interrupted=signal or Signal(), opening=opening,
    )  # fmt: skip


@contextmanager
def opened_rig(
    description: RigDescription | None = None,
    person: Person | None = None,
    opening: Opening = WHOLE,
    hardware: SimulatedHardware | None = None,
) -> Iterator[OpenedRig]:
    """Open a simulated rig over a hardware of which the test keeps hold; it is not closed by this."""
    description, signal, person = description or simulated_rig(), Signal(), person or Person()
    assert description.world is not None
    hardware = hardware or SimulatedHardware(description, description.world, seed=1)
    rig = make_rig(description, hardware, opening, person, signal)
    yield OpenedRig(rig, hardware, signal, person)
    rig._link.close()
    hardware.close()


@contextmanager
def ready_rig(
    *overrides: str, opening: Opening = WHOLE, moves: tuple[str, float, float] | None = None
) -> Iterator[OpenedRig]:
    """Open a simulated rig, connected and referenced, in which an axis may move to a position at a speed."""
    with opened_rig(simulated_rig(*overrides), opening=opening) as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        if moves is not None:
            opened.rig.axis(moves[0]).start_move(*moves[1:])
            opened.rig.wait(1.0)
        yield opened
