"""What an insertion to a target writes: what it aims at, what it sees and believes, which paths it finds."""

from typing import ClassVar

from pydantic import BaseModel, ConfigDict

from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.experiments.shared.sheath_event import SheathEvent
from labrig.record.events import Event, PictureRole, TrialStop, TruthLine
from labrig.steering.planner import PlannedArc
from labrig.steering.problem import Obstacle

_Pixel = tuple[float, float]
_Point = tuple[float, float, float]


class InsertionRole(PictureRole):
    """Pictures in which the target is named, the sheath is found, the plan is drawn; others are `NeedleRole`."""

    TARGET = "target"
    SCENE = "scene"
    PLAN = "plan"


class InsertionStart(SpecimenTrialStart):
    """An insertion begins: what is aimed at, what is kept off, and the roll zero that it goes by."""

    target_mm: _Point
    tolerance_mm: float
    obstacles: tuple[Obstacle, ...]
    start_mm: _Point
    start_heading_rad: float
    roll_zero_rad: float
    roll_zero_sd_rad: float


class InsertionStop(TrialStop):
    """An insertion has ended: `reached`, `missed` or `stopped`, on which command and why, and how deep."""

    outcome: str
    stop: str | None
    cause: str
    final_frame: int
    depth_mm: float
    replans: int


class InsertionSheath(SheathEvent):
    """Where the sheath stands in a trial; the insertion starts there where it is accepted."""

    kind: ClassVar[str] = "origin"


class InsertionEvent(Event):
    """Something that happened in a trial."""

    trial: int


class BevelTurn(InsertionEvent):
    """The bevel is turned, the needle standing."""

    kind: ClassVar[str] = "flip"

    depth_mm: float
    from_rad: float
    to_rad: float


class NeedleHeld(InsertionEvent):
    """The needle stands at its end before the last picture."""

    kind: ClassVar[str] = "hold"

    stop: str | None
    detail: str


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class RecordedEstimate(_Part):
    """The tip as the estimator believes it; `radius_mm` is None of a straight one."""

    position_mm: _Point
    heading_rad: float
    position_sd_mm: float | None
    heading_sd_rad: float | None
    radius_mm: float | None


class TipObserved(InsertionEvent):
    """A picture on the way: where the tip was looked for and found, and what is believed of it since."""

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


class RecordedPose(_Part):
    """The pose at which a path begins."""

    position_mm: _Point
    heading_rad: float
    rotation: tuple[_Point, _Point, _Point]


class PathSought(InsertionEvent):
    """A path was sought: on which occasion, from where, and what was found or why nothing was."""

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
    """What the simulated world says of an insertion: its path [mm], and how near it came to target and obstacles."""

    path_mm: tuple[_Point, ...] = ()
    true_target_error_mm: float | None = None
    true_min_clearance_mm: float | None = None
