"""The events of an insertion to a target: its aim, its observations and estimates, and the paths that it plans."""

from typing import ClassVar

from pydantic import BaseModel, ConfigDict

from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.experiments.shared.sheath_event import SheathEvent
from labrig.record.events import Event, PictureRole, TrialStop, TruthLine
from labrig.steering.planner import PlannedArc
from labrig.steering.problem import Obstacle
from labrig.steering.torsion import TorsionalLag

_Pixel = tuple[float, float]
_Point = tuple[float, float, float]


class InsertionRole(PictureRole):
    """Pictures in which the target is picked, markers or the sheath are found, or the plan is drawn.

    Others have a `NeedleRole`.
    """

    TARGET = "target"
    MARKERS = "markers"
    SCENE = "scene"
    PLAN = "plan"


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class InsertionStart(SpecimenTrialStart):
    """An insertion begins: its target, its obstacles, and the roll zero and torsion in use.

    `marker_ids` are the markers that
    the target and each obstacle are bound to, the target's first; None for what is bound to none.
    """

    target_mm: _Point
    tolerance_mm: float
    obstacles: tuple[Obstacle, ...]
    start_mm: _Point
    start_heading_rad: float
    roll_zero_rad: float
    roll_zero_sd_rad: float
    torsion: TorsionalLag | None = None
    marker_ids: tuple[int | None, ...] = ()


class InsertionStop(TrialStop):
    """An insertion has ended: its outcome, and at which depth; one that did not leave its sheath has no last picture.

    `centred` is the direction in which the bevel was turned to the roll zero before: 1, -1, or 0 if it is not known.
    `error_mm` and `interval_mm` are the distances from the target in the plane and, with a probability of 95 %, in
    space, by the last picture.
    """

    outcome: str = "stopped"
    final_frame: int | None = None
    depth_mm: float = 0.0
    replans: int = 0
    centred: int = 0
    error_mm: float | None = None
    interval_mm: tuple[float, float] | None = None


class InsertionSheath(SheathEvent):
    """The sheath's pose in a trial; the insertion starts there if it is accepted."""

    kind: ClassVar[str] = "origin"


class InsertionEvent(Event):
    """An event of a trial."""

    trial: int


class BevelTurn(InsertionEvent):
    """The rotation axis turns the bevel while the needle stands still; it first goes past `to_rad` by the overshoot."""

    kind: ClassVar[str] = "flip"

    depth_mm: float
    from_rad: float
    to_rad: float
    overshoot_rad: float = 0.0


class NeedleHeld(InsertionEvent):
    """The needle stands still before the last picture."""

    kind: ClassVar[str] = "hold"

    stop: str | None
    detail: str


class RecordedEstimate(_Part):
    """The estimated tip; `radius_mm` is None for a straight needle."""

    position_mm: _Point
    heading_rad: float
    position_sd_mm: float | None
    heading_sd_rad: float | None
    radius_mm: float | None


class TipObserved(InsertionEvent):
    """A picture on the way: where the tip was searched and found, and the estimate after it."""

    kind: ClassVar[str] = "observation"

    frame: int
    depth_mm: float
    step_mm: float
    bevel_rad: float
    accepted: bool
    reason: str | None
    tip_px: _Pixel | None
    heading_rad: float
    score: float | None
    distinctness: float | None
    seen_heading_rad: float | None
    near_px: _Pixel
    region_px: float
    tip_mm: _Point | None
    estimate: RecordedEstimate
    innovation_mm: _Point | None
    nis: float | None
    believed: bool
    misses: int


class RecordedMarker(_Part):
    """A marker in a picture: its corners, its place and its displacement since the start, (y, z), by this picture.

    `reason` says why it was not found. `displacement_mm` is what was planned with, which is held while the marker is
    not seen or not believed; `unseen_mm` is how far the needle has moved since it was.
    """

    marker_id: int
    corners_px: tuple[_Pixel, _Pixel, _Pixel, _Pixel] | None
    place_mm: _Pixel | None
    reason: str | None
    believed: bool
    displacement_mm: _Pixel
    sd_mm: float
    unseen_mm: float


class MarkersSought(InsertionEvent):
    """The markers in a picture, in the order of their ids; the first event of a trial says where they start."""

    kind: ClassVar[str] = "markers"

    frame: int
    depth_mm: float
    markers: tuple[RecordedMarker, ...]


class RecordedPose(_Part):
    """The pose at which a path begins."""

    position_mm: _Point
    heading_rad: float
    rotation: tuple[_Point, _Point, _Point]


class PathSought(InsertionEvent):
    """The planner ran: on which occasion, from where, and what it found or why it found nothing."""

    kind: ClassVar[str] = "plan"

    frame: int | None
    depth_mm: float
    because: str
    refusal: str | None
    replans: int
    from_mm: float
    start: RecordedPose
    found: bool
    reason: str | None
    arcs: tuple[PlannedArc, ...]
    tip_mm: _Point | None
    target_error_mm: float | None
    clearance_mm: float | None
    length_mm: float | None
    worst_target_error_mm: float | None
    worst_clearance_mm: float | None


class TrueInsertion(TruthLine):
    """The truth of an insertion in the simulated world: its path [mm], and its distances from target and obstacles."""

    path_mm: tuple[_Point, ...] = ()
    true_target_error_mm: float | None = None
    true_min_clearance_mm: float | None = None
