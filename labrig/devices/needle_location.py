"""Where the needle is when a run ends: whether it stands still, whether it is in tissue, and the position of each axis.

What is not known is said to be unknown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from labrig.devices.axis import Axis
from labrig.devices.needle_state import RigState
from labrig.errors import (
    BusError,
    BusPassiveError,
    DriveError,
    DriveRestartedError,
    DriveSilentError,
    MachineError,
)

LastPositions = Mapping[str, tuple[float, float]]

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
        reference = "" if self.referenced else " (no reference)"
        return f"{self.axis} {self.position:.{digits}f} {self.unit}{reference}{age}"


@dataclass(frozen=True)
class NeedleLocation:
    """Where the needle is.

    Parameters
    ----------
    unknown_motion : str
        Why it is not known whether the axes stand still; empty if each was seen to stand.
    in_tissue : bool or None
        Whether the needle is in tissue; None if it is not known.
    doubt : str
        Why it is or may be in tissue.
    axes : sequence of AxisLocation
        The axes.
    """

    unknown_motion: str
    in_tissue: bool | None
    doubt: str
    axes: Sequence[AxisLocation]

    @property
    def motion(self) -> str:
        """What the needle is doing, or that it is not known, and then what to do at once."""
        if self.unknown_motion:
            doing = "what the needle is doing is not known"
            return f"{self.unknown_motion}: press the emergency stop; {doing}; {self._place}"
        return f"every axis stands still; {self._place}"

    @property
    def _place(self) -> str:
        if self.in_tissue is None:
            return f"whether a needle is in tissue is not known ({self.doubt})"
        return "the needle is in tissue" if self.in_tissue else "no needle is in tissue"

    @property
    def where(self) -> str:
        """Return the position of each axis."""
        return ", ".join(map(str, self.axes))

    def document(self) -> dict[str, object]:
        """Return it ready for JSON."""
        return {
            "motion": "unknown" if self.unknown_motion else "standing still",
            "unknown_because": self.unknown_motion or None,
            "in_tissue": self.in_tissue,
            "axes": [asdict(axis) for axis in self.axes],
        }


def are_drives_lost(error: Exception) -> bool:
    """Tell whether an error means that drives can no longer be told to stop."""
    return isinstance(error, BusError | DriveSilentError) and not isinstance(error, BusPassiveError)


def locate_needle(
    axes: Sequence[Axis],
    state: RigState,
    last: LastPositions,
    now_s: float,
    unknown_motion: str,
    *,
    ask: bool,
) -> NeedleLocation:
    """Return where the needle is.

    Parameters
    ----------
    axes : sequence of Axis
        The open axes.
    state : RigState
        Whether it is in tissue, and which axes have their reference.
    last : mapping of str to tuple of float
        Axis -> when it was read last [s], and where it was [mm or rad].
    now_s : float
        Rig time [s].
    unknown_motion : str
        Why it is not known whether the axes stand still; empty if each was seen to stand.
    ask : bool
        Whether the drives are asked, those in fault too. Without it, and for a drive that does not answer or has lost
        its position, the last reading counts.
    """

    def locate(axis: Axis) -> AxisLocation:
        (read_s, position), why_old = last.get(axis.name, (None, None)), ""
        if ask:
            try:
                read_s, position = now_s, _read_position(axis)
            except MachineError as error:
                why_old = error.message
        age_s = None if read_s is None else now_s - read_s
        return AxisLocation(axis.name, axis.unit, position, age_s, axis.name in state.referenced, why_old)

    return NeedleLocation(unknown_motion, state.needle_in_tissue, state.doubt, tuple(map(locate, axes)))


def _read_position(axis: Axis) -> float:
    """Return the position of an axis, also of a drive in fault. Raises `MachineError` where it has lost it."""
    try:
        axis.drive.check()
    except (DriveRestartedError, DriveSilentError):
        raise
    except MachineError:
        pass  # a drive in fault still answers
    return axis.drive.position()


def name_loss(error: Exception) -> str:
    """Return what a person is told at once of drives that are lost."""
    axis = error.axis if isinstance(error, DriveError) else ""
    return f"the drive of axis {axis} does not answer" if axis else "the drives do not answer"
