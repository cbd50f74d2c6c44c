"""What a simulated rig and its fault script need from a simulated drive of any kind."""

from typing import Protocol

from labrig.devices.simulated.drive_journal import DriveJournal


class SimulatedNode(Protocol):
    """A simulated drive on a wire, with its motor shaft."""

    node_id: int
    journal: DriveJournal

    @property
    def shaft_counts(self) -> float:
        """Where the motor shaft is, in counts of the drive, independent of its counter."""

    @property
    def is_moving(self) -> bool:
        """Whether a profile is under way."""

    @property
    def is_homing(self) -> bool:
        """Whether homing is under way."""

    def tick(self) -> None:
        """Do what is due by now; called whenever time advances."""

    def unplug(self) -> None:
        """Leave the bus silently; a moving shaft keeps moving."""

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""

    def fail(self, code: int) -> None:
        """Go to fault with an error code: send an EMCY, and brake or lose power as the code requires."""

    def cut_power_stage(self) -> None:
        """Cut the supply of the power stage, as an emergency stop does; the fault stays until the supply is back."""

    def block(self) -> None:
        """Block the shaft where it is."""

    def uncouple(self) -> None:
        """Let the motor lose its shaft: it lags, and no current shows why."""

    def mute(self) -> None:
        """Send nothing from now on."""

    def deafen(self) -> None:
        """Receive nothing."""

    def restart(self) -> None:
        """Lose power and come back: settings, reference and counter are lost, the shaft stays where it is."""

    def stop_heartbeat(self) -> None:
        """Stop the heartbeat; everything else continues."""

    def abort_next(self, code: int) -> None:
        """Refuse the next SDO request with an abort code."""

    def ignore_next(self, requests: int) -> None:
        """Ignore the next SDO requests."""

    def set_encoder(self, pulses: int) -> None:
        """Change the encoder resolution, as if somebody had changed the settings."""

    def press(self, inputs: int) -> None:
        """Hold switches closed: bit 0 the negative limit switch, bit 1 the positive one."""

    def set_input(self, name: str, value: float) -> None:
        """Put an analog input at a voltage [mV], or switch a digital input on (not 0) or off (0)."""
