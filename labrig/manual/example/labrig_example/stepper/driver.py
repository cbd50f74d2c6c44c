"""The driver of the stepper: its additions to CiA 402, and its part of `labrig devices check`."""

from collections.abc import Iterator

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.canopen_objects import Entry
from labrig.devices.check_result import CheckResult, CheckStatus, failed
from labrig.devices.cia402_drive import Cia402Drive
from labrig.devices.drive import Homing, Identity
from labrig.errors import DriveError, LabrigError
from labrig_example.stepper.settings import StepperAxis

VENDOR, PRODUCT = 0x7E57, 0x0001


class Stepper(Cia402Drive[StepperAxis]):
    """One stepper drive."""

    def __init__(self, link: CanLink, section: StepperAxis, axis: str, clock: Clock) -> None:
        super().__init__(link, section, axis, clock, node_id=section.node_id)

    def identify(self) -> Identity:
        """Return the identity of the drive. Raises `DriveError` if it is another one."""
        found = (self.wake(), self.upload(co.PRODUCT_CODE))
        if found != (VENDOR, PRODUCT):
            raise DriveError(
                f"{self.name} is vendor 0x{found[0]:X}, product 0x{found[1]:X}, expected 0x{VENDOR:X}, 0x{PRODUCT:X}",
                "check the node id in the rig file and the drive itself",
            )
        return Identity("example stepper", self.upload(co.SERIAL_NUMBER))

    def settings_of(self, heartbeat: HeartbeatDescription) -> dict[Entry, int]:
        """Return the settings of its section, including the heartbeat consumer."""
        section, scale = self.section, self.scale
        acceleration = scale.to_acceleration_units(section.acceleration)
        return {
            co.MAX_FOLLOWING_ERROR: scale.to_distance_counts(section.max_following_error),
            co.POSITION_WINDOW: scale.to_distance_counts(section.position_window),
            co.POSITION_WINDOW_TIME: section.position_window_time_ms,
            co.MAX_PROFILE_VELOCITY: scale.to_speed_units(section.max_speed),
            co.PROFILE_ACCELERATION: acceleration,
            co.PROFILE_DECELERATION: acceleration,
            co.QUICK_STOP_DECELERATION: scale.to_acceleration_units(section.quick_stop_deceleration),
            co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms,
        }

    def homing_settings(self, homing: Homing) -> Iterator[tuple[Entry, int]]:
        """Yield the counter that the present position is to get."""
        yield co.HOME_OFFSET, self.home_counter(homing)

    def inputs(self) -> dict[str, bool]:
        """Return no inputs: the drive has none."""
        return {}


def check_axis(
    link: CanLink,
    axis: StepperAxis,
    name: str,
    clock: Clock,
    heartbeat: HeartbeatDescription,  # noqa: ARG001 - nothing of it is checked
) -> Iterator[CheckResult]:
    """Check that the drive answers and has no fault; nothing is written."""
    drive = Stepper(link, axis, name, clock)
    try:
        identity = drive.identify()
        drive.raise_if_faulted()
        yield CheckResult(
            f"drive {name}",
            CheckStatus.PASS,
            f"node {axis.node_id}: {identity.model}, serial {identity.serial_number}",
        )
    except LabrigError as error:
        yield failed(f"drive {name}", error)
