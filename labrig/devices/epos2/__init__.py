"""The kind of drive `epos2`: maxon EPOS2 over CANopen."""

from labrig.clock import Clock
from labrig.devices.canopen_objects import Entry
from labrig.devices.drive import DriveKind
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.check import check_axis
from labrig.devices.epos2.driver import Epos2
from labrig.devices.epos2.settings import Epos2Axis
from labrig.devices.epos2.simulated_drive import SimulatedDrive
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics

_ENTRIES = {(entry.index, entry.subindex): entry for entry in od.NUMBERS}


def _find_object(_section: Epos2Axis, index: int, subindex: int) -> Entry | None:
    return _ENTRIES.get((index, subindex))


def _simulate(
    section: Epos2Axis, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float
) -> SimulatedDrive:
    return SimulatedDrive(
        wire,
        section.node_id,
        clock,
        encoder_pulses=section.encoder_pulses_per_turn or od.ENCODER_PULSES.default,
        mechanics=mechanics,
        boot_time_s=boot_time_s,
    )


def _example(node_id: int) -> Epos2Axis:
    """Return a section for a drive with factory settings, on a screw without a gear."""
    return Epos2Axis(
        node_id=node_id,
        unit="mm",
        encoder_pulses_per_turn=od.ENCODER_PULSES.default,
        gear_ratio=1.0,
        lead_mm=1.0,
        limits=(-100.0, 100.0),
        max_speed=20.0,
        acceleration=50.0,
        quick_stop_deceleration=200.0,
        position_window=0.01,
        max_following_error=1.0,
    )


DRIVE = DriveKind(
    name="epos2",
    settings=Epos2Axis,
    open=Epos2,
    check=check_axis,
    find_object=_find_object,
    simulated_node=_simulate,
    example=_example,
)
