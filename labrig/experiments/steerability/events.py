"""Events of a steerability sweep."""

from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.record.events import PictureRole, TrialStop


class SweepRole(PictureRole):
    """Pictures before the needle leaves the sheath; those of the needle have a `NeedleRole`."""

    HOLE = "hole"
    SHEATH = "sheath"


class SweepTrialStart(SpecimenTrialStart):
    """An insertion begins."""


class SweepTrialStop(TrialStop):
    """An insertion has ended, with the picture of its final shape; None if it was interrupted."""

    final_frame: int | None = None
