"""The kind of drive `cia402`: any CiA 402 drive in profile position mode over CANopen."""

from labrig.clock import Clock
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402.check import check_axis
from labrig.devices.cia402.driver import ProfileDrive
from labrig.devices.cia402.settings import Cia402Axis, ObjectsOfMaker
from labrig.devices.cia402.simulated_drive import SimulatedProfileDrive
from labrig.devices.drive import DriveKind
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import InputError


def _find_object(section: Cia402Axis, index: int, subindex: int) -> Entry | None:
    try:
        return section.read_eds().find(Entry(index, subindex, "", "B"))
    except InputError:
        return None


def _simulate(
    section: Cia402Axis, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float
) -> SimulatedProfileDrive:
    return SimulatedProfileDrive(section, wire, clock, mechanics, boot_time_s)


def _example(node_id: int) -> Cia402Axis:
    """Return a section for an EPOS4 with factory settings, on a screw without a gear."""
    return Cia402Axis(
        driver="cia402",
        node_id=node_id,
        eds=None,
        unit="mm",
        counts_per_turn=2000.0,
        gear_ratio=1.0,
        lead_mm=1.0,
        velocity_unit="rpm",
        acceleration_unit="rpm/s",
        limits=(-100.0, 100.0),
        max_speed=20.0,
        acceleration=50.0,
        quick_stop_deceleration=200.0,
        position_window=0.01,
        max_following_error=1.0,
        referenced_bit=15,
        objects=ObjectsOfMaker(
            home_position="0x30B0:00",
            counts_per_turn="0x3000:05",
            current_ma="0x30D1:01",
            current_limit_ma="0x3001:02",
        ),
    )


DRIVE = DriveKind(
    name="cia402",
    settings=Cia402Axis,
    open=ProfileDrive,
    check=check_axis,
    find_object=_find_object,
    simulated_node=_simulate,
    example=_example,
)
