"""Where the needle is when a run ends: whether it stands still, whether it is in tissue, and the position of each axis.

What is not known is said to be unknown.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

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
