"""What a simulated rig, its fault script and tests need from a simulated drive of any kind, and what it did."""

from collections import deque
from dataclasses import dataclass
from typing import Protocol

_KEPT = 10_000


@dataclass(frozen=True)
class DriveEvent:
    """An event of a drive.

    Parameters
    ----------
    t_s : float
        The exact instant, not that of the tick that noticed it.
    kind : str
        boot, nmt, state, emergency, set-point, brake, still or homing.
    text : str
        The state entered, the error code, or similar.
    shaft_counts : float
        Position of the shaft.
    """

    t_s: float
    kind: str
    text: str
    shaft_counts: float


class DriveJournal(deque[DriveEvent]):
    """The last events of a drive, oldest first."""

    def __init__(self) -> None:
        super().__init__(maxlen=_KEPT)

    def last(self, kind: str) -> DriveEvent | None:
        """Return the newest event of a kind, or None."""
        return next((event for event in reversed(self) if event.kind == kind), None)


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
