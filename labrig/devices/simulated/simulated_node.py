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

    def fail(self, code: int) -> None:
        """Go to fault with an error code: send an EMCY, and brake or lose power as the code requires."""

    def cut_power_stage(self) -> None:
        """Cut the supply of the power stage, as an emergency stop does; the fault stays until the supply is back."""

    def block(self) -> None:
        """Block the shaft where it is."""

    def mute(self) -> None:
        """Send nothing from now on."""

    def restart(self) -> None:
        """Lose power and come back: settings, reference and counter are lost, the shaft stays where it is."""

    def set_input(self, name: str, value: float) -> None:
        """Put an analog input at a voltage [mV], or switch a digital input on (not 0) or off (0)."""
