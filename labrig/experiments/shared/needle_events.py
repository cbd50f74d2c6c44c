"""What the runs write that show a needle on its way: in which gel each trial is made, and what its pictures show."""

from labrig.record.events import PictureRole, TrialStart, TruthLine


class NeedleRole(PictureRole):
    """Pictures of a needle: on its way at rest or in motion, where its way ended, or taken elsewhere."""

    ADVANCE = "advance"
    OBSERVE = "observe"
    FINAL = "final"
    IMPORTED = "imported"


class SpecimenTrialStart(TrialStart):
    """An insertion begins: into which block of gel, through which entry point, with which needle."""

    specimen: str
    gelatin_percent: float
    hole: int
    hole_position_mm: float
    needle_id: str

    @property
    def pair(self) -> tuple[str, str]:
        """Needle and specimen, the paper's needle-tissue pair, by which insertions are grouped."""
        return self.needle_id, self.specimen


class DrawnRadius(TruthLine):
    """The radius that the simulated world drew for a trial; None where the gel has none."""

    radius_mm: float | None = None
