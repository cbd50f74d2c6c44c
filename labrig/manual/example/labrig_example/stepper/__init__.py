"""The kind of drive `example-stepper`: a CiA 402 stepper drive."""

from labrig.clock import Clock
from labrig.devices.drives import objects as co
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import DriveKind
from labrig.devices.drives.model import find_object
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.kinds import CIA402
from labrig.devices.simulated.shaft import Mechanics
from labrig_example.stepper.settings import PRODUCT, VENDOR, StepperAxis


def _simulate(
    section: StepperAxis, wire: InProcessWire, clock: Clock, mechanics: Mechanics, boot_time_s: float
) -> SimulatedCia402Drive:
    """Return a node with the state machine, faults and motion of CiA 402."""
    fixed = {co.VENDOR_ID: VENDOR, co.PRODUCT_CODE: PRODUCT, co.SERIAL_NUMBER: 7000 + section.node_id}
    return SimulatedCia402Drive(section, wire, clock, mechanics, boot_time_s, behaviour=CIA402, fixed=fixed)


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
    open=Cia402Drive,
    check=check_axis,
    find_object=find_object,
    simulated_node=_simulate,
    example=_example,
)
