"""What a run writes: used by the procedure that writes it and by the analysis that reads it."""

from labrig.record.events import PictureRole, TrialStart, TrialStop


class VisitStart(TrialStart):
    """The axis sets out."""

    far_mm: float


class VisitStop(TrialStop):
    """The axis is back, and the picture that was taken there."""

    final_frame: int


class Role(PictureRole):
    """What a picture was taken for."""

    MARKER = "marker"
