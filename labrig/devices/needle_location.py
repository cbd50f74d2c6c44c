"""Where the needle is when a run ends: whether it stands still, whether it is in tissue, and the position of each axis.

What is not known is said to be unknown.
"""

from contextlib import suppress
from dataclasses import asdict, dataclass

from labrig.devices.axis import Axis
from labrig.devices.needle_state import RigState
from labrig.errors import BusError, BusPassiveError, DriveFaultError, DriveSilentError, MachineError

_JUST_NOW_S = 0.1
"""A position that is no older is told without its age [s]."""


@dataclass(frozen=True)
class AxisLocation:
    """The last position of an axis.

    Parameters
    ----------
    axis, unit : str
        The axis, and mm or rad.
    position : float or None
        None if it was never read [mm or rad].
    age_s : float or None
        How long ago it was read [s].
    referenced : bool
        Whether the axis has its reference.
    why_old : str
        Why it was not read just now; empty if it was.
    """

    axis: str
    unit: str
    position: float | None
    age_s: float | None
    referenced: bool
    why_old: str = ""

    def __str__(self) -> str:
        """Return axis, position and age as a person reads them."""
        if self.position is None or self.age_s is None:
            return f"{self.axis} not known"
        digits = 2 if self.unit == "mm" else 3
        age = f" {self.age_s:.1f} s ago" if self.age_s > _JUST_NOW_S else ""
        reference = "" if self.referenced else " (zero not known)"
        return f"{self.axis} {self.position:.{digits}f} {self.unit}{reference}{age}"


@dataclass(frozen=True)
class NeedleLocation:
    """Where the needle is.

    Parameters
    ----------
    unknown_motion : str
        Why it is not known whether the axes stand still; empty if each was seen to stand.
    state : RigState
        Whether the needle is in tissue.
    axes : tuple of AxisLocation
        The axes.
    """

    unknown_motion: str
    state: RigState
    axes: tuple[AxisLocation, ...]

    @property
    def motion(self) -> str:
        """What the needle is doing, or that it is not known, and then what to do at once."""
        doing = "every axis stands still"
        if self.unknown_motion:
            doing = f"{self.unknown_motion}: press the emergency stop; what the needle is doing is not known"
        return f"{doing}; {self.state.place}"

    @property
    def where(self) -> str:
        """Return the position of each axis."""
        return ", ".join(map(str, self.axes))

    def document(self) -> dict[str, object]:
        """Return it ready for JSON."""
        return {
            "motion": "unknown" if self.unknown_motion else "standing still",
            "unknown_because": self.unknown_motion or None,
            "in_tissue": self.state.needle_in_tissue,
            "axes": [asdict(axis) for axis in self.axes],
        }


def are_drives_lost(error: Exception) -> bool:
    """Tell whether an error means that drives can no longer be told to stop."""
    return isinstance(error, BusError | DriveSilentError) and not isinstance(error, BusPassiveError)


def locate_axis(axis: Axis, now_s: float, *, referenced: bool, ask: bool) -> AxisLocation:
    """Return where an axis is.

    Parameters
    ----------
    axis : Axis
        The axis.
    now_s : float
        Rig time [s].
    referenced : bool
        Whether the axis has its reference.
    ask : bool
        Whether the drive is asked, also one in fault. Without it, and for a drive that does not answer or has lost its
        position, the last reading counts.
    """
    read_s, _, position = axis.last or (None, None, None)
    why_old = ""
    if ask:
        try:
            with suppress(DriveFaultError):  # a drive in fault still answers
                axis.drive.check()
            read_s, position = now_s, axis.drive.position()
        except MachineError as error:
            why_old = error.message
    age_s = None if read_s is None else now_s - read_s
    return AxisLocation(axis.name, axis.unit, position, age_s, referenced, why_old)
