"""The events of a run, which the procedure writes and the analysis reads."""

from labrig.record.events import PictureRole, TrialStart, TrialStop


class VisitStart(TrialStart):
    """The axis moves away."""

    far_mm: float


class VisitStop(TrialStop):
    """The axis is back; `final_frame` is the picture taken there."""

    final_frame: int


class Role(PictureRole):
    """Purpose of a picture."""

    MARKER = "marker"
