"""What a simulated rig and its fault script ask of a simulated drive, of whatever kind."""

from typing import Protocol

from labrig.devices.simulated.drive_journal import DriveJournal


class SimulatedNode(Protocol):
    """A simulated drive on a wire, with the motor's shaft that it turns."""

    node_id: int
    journal: DriveJournal

    @property
    def shaft_counts(self) -> float:
        """Where the motor's shaft stands, in counts of the drive, whatever its counter has been set to."""

    @property
    def is_moving(self) -> bool:
        """Whether a profile is under way."""

    @property
    def is_homing(self) -> bool:
        """Whether homing is under way."""

    def tick(self) -> None:
        """Do what has become due by now; called whenever time advances."""

    def unplug(self) -> None:
        """Leave the bus without a word; what moves goes on moving."""

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""

    def fail(self, code: int) -> None:
        """Go to fault with an error code: tell it by EMCY, and brake or lose power as the code has it."""

    def cut_power_stage(self) -> None:
        """Take the supply of the power stage away, as an emergency stop does; the fault stays until it is back."""

    def block(self) -> None:
        """Block the shaft where it stands."""

    def mute(self) -> None:
        """Send nothing any more."""

    def deafen(self) -> None:
        """Hear nothing."""

    def restart(self) -> None:
        """Lose power and come back: settings, reference and counter are lost, the shaft stays where it is."""

    def stop_heartbeat(self) -> None:
        """Produce no heartbeat any more; everything else goes on."""

    def abort_next(self, code: int) -> None:
        """Refuse the next SDO request with an abort code."""

    def ignore_next(self, requests: int) -> None:
        """Leave the next SDO requests without answer or effect."""

    def set_encoder(self, pulses: int) -> None:
        """Have another encoder resolution than before, as if somebody had changed the settings."""

    def press(self, inputs: int) -> None:
        """Hold switches closed: bit 0 the negative limit switch, bit 1 the positive one."""
