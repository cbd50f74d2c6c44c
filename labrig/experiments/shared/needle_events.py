"""Events and picture roles of runs that insert a needle: the gel of each trial, and what its pictures show."""

from typing import ClassVar

from labrig.record.events import PictureRole, TrialStart, TrialStop, TruthLine


class NeedleRole(PictureRole):
    """Pictures of a hole before the sheath enters, and of the sheath before the needle leaves it.

    Of the needle: on its way, at rest or in motion; at its end; or imported.
    """

    HOLE = "hole"
    SHEATH = "sheath"
    ADVANCE = "advance"
    OBSERVE = "observe"
    FINAL = "final"
    IMPORTED = "imported"


class SpecimenTrialStart(TrialStart):
    """An insertion begins: its block of gel, its entry point, and its needle."""

    noun: ClassVar[str] = "insertion"

    specimen: str
    gelatin_percent: float
    hole: int
    hole_position_mm: float
    needle_id: str

    @property
    def pair(self) -> tuple[str, str]:
        """Needle and specimen, the paper's needle-tissue pair, by which insertions are grouped."""
        return self.needle_id, self.specimen


class SpecimenTrialStop(TrialStop):
    """An insertion has ended, with the picture of its final shape; None if it was interrupted."""

    final_frame: int | None = None


class DrawnRadius(TruthLine):
    """The radius that the simulated world drew for a trial; None if the gel has none."""

    radius_mm: float | None = None
