"""The kind of drive `example-stepper`: a CiA 402 stepper drive."""

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.drive import DriveKind
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig_example.stepper.driver import Stepper, check_axis
from labrig_example.stepper.settings import StepperAxis
from labrig_example.stepper.simulated_drive import SimulatedStepper

_ENTRIES = {(entry.index, entry.subindex): entry for entry in co.STANDARD}


def _find_object(_section: StepperAxis, index: int, subindex: int) -> Entry | None:
    return _ENTRIES.get((index, subindex))


def _simulate(
    section: StepperAxis, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float
) -> SimulatedStepper:
    return SimulatedStepper(wire, section, clock, mechanics, boot_time_s)


def _example(node_id: int) -> StepperAxis:
    """Return a section for a drive on a screw without a gear."""
    return StepperAxis(
        node_id=node_id,
        unit="mm",
        microsteps_per_turn=3200,
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
    name="example-stepper",
    settings=StepperAxis,
    open=Stepper,
    check=check_axis,
    find_object=_find_object,
    simulated_node=_simulate,
    example=_example,
)
