"""What a steerability sweep writes of its insertions."""

from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.record.events import PictureRole, TrialStop


class SweepRole(PictureRole):
    """Pictures before the needle leaves the sheath; those of the needle are `NeedleRole`."""

    HOLE = "hole"
    SHEATH = "sheath"


class SweepTrialStart(SpecimenTrialStart):
    """An insertion begins; `repeats` is the interrupted trial in whose stead it is made."""

    repeats: int | None = None


class SweepTrialStop(TrialStop):
    """An insertion has ended, with the picture of its final shape; an interrupted one has none."""

    final_frame: int | None = None
