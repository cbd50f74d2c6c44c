"""The events of an insertion to a target: its aim, its observations and estimates, and the paths that it plans."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from labrig.analysis.result import Point
from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.experiments.shared.sheath_event import SheathEvent
from labrig.needle.kinematics import FloatArray
from labrig.record.events import Event, PictureRole, TrialStop, TruthLine
from labrig.steering.planner import Plan
from labrig.steering.problem import Obstacle
from labrig.steering.refusal import RefusalCause
from labrig.steering.state import SteeringState
from labrig.steering.torsion import TorsionalLag
from labrig.vision.tip import TipFix

_Pixel = tuple[float, float]
_Point = tuple[float, float, float]

NIS_95 = 5.99
"""95 % of the values of a chi-squared distribution with two degrees of freedom lie below."""


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


class Sighted(_Part):
    """A picture on the way: where the tip was found, and the estimate after it; places are (y, z).

    `tip_mm` is where the template found the tip; if it is None, `reason` says why; `believed` says whether the
    estimator took it; `innovation_mm` is how far it was from the prediction. `radius_mm` is None for a straight needle,
    `slip` the share of the inserted length by which the tip stays behind.
    """

    frame: int
    depth_mm: float
    tip_mm: Point | None
    reason: str | None
    score: float | None
    estimate_mm: Point
    position_sd_mm: float
    heading_rad: float
    heading_sd_rad: float
    radius_mm: float | None
    slip: float = 0.0
    believed: bool
    nis: float | None
    innovation_mm: Point | None


def describe_sighting(
    fix: TipFix, seen_mm: FloatArray | None, predicted_mm: FloatArray, state: SteeringState
) -> dict[str, Any]:
    """Return the fields of `Sighted` behind its frame.

    Parameters
    ----------
    seen_mm, predicted_mm : (3,) array
        The tip as it was found (None: it was not), and as it was predicted.
    state : SteeringState
        After the sighting.
    """
    tip = state.tip
    return {
        "depth_mm": state.insertion_mm,
        "tip_mm": None if seen_mm is None else tuple(seen_mm[1:].tolist()),
        "reason": fix.reason,
        "score": fix.score,
        "estimate_mm": tuple(tip.position_mm[1:].tolist()),
        "position_sd_mm": tip.position_sd_mm,
        "heading_rad": tip.heading_rad,
        "heading_sd_rad": tip.heading_sd_rad,
        "radius_mm": 1.0 / tip.curvature if tip.curvature > 0.0 else None,
        "slip": tip.slip,
        "believed": tip.accepted,
        "nis": tip.nis,
        "innovation_mm": None if seen_mm is None else tuple((seen_mm - predicted_mm)[1:].tolist()),
    }


class TipObserved(InsertionEvent, Sighted):
    """A picture on the way, and how the tip was searched for in it."""

    kind: ClassVar[str] = "observation"

    bevel_rad: float
    accepted: bool
    tip_px: _Pixel | None
    distinctness: float | None
    near_px: _Pixel
    region_px: float
    misses: int


class SeenMarker(_Part):
    """A marker in a picture: its place and its displacement since the start, (y, z).

    `reason` says why it was not found. `displacement_mm` is what was planned with, which is held while the marker is
    not seen or not believed; `unseen_mm` is how far the needle has moved since it was.
    """

    marker_id: int
    place_mm: _Pixel | None
    reason: str | None
    believed: bool
    displacement_mm: _Pixel
    sd_mm: float
    unseen_mm: float


class RecordedMarker(SeenMarker):
    """A marker in a picture with its corners."""

    corners_px: tuple[_Pixel, _Pixel, _Pixel, _Pixel] | None


class MarkersSought(InsertionEvent):
    """The markers in a picture, in the order of their ids; the first event of a trial says where they start."""

    kind: ClassVar[str] = "markers"

    frame: int
    depth_mm: float
    markers: tuple[RecordedMarker, ...]


class PathSought(InsertionEvent):
    """The planner ran: on which occasion, from which pose, and what it found or why it found nothing.

    `refusal` says why there is no path, `cause` the same by its name; `plan` is then the one before.
    """

    kind: ClassVar[str] = "plan"

    frame: int | None
    depth_mm: float
    because: str
    refusal: str | None
    cause: RefusalCause | None = None
    replans: int
    from_mm: float
    start_mm: _Point
    start_rotation: tuple[_Point, _Point, _Point]
    plan: Plan


@dataclass(frozen=True)
class TrueObstacle(Obstacle):
    """An obstacle of the simulated world where it is, and its least clearance from the needle."""

    clearance_mm: float


class TrueInsertion(TruthLine):
    """The truth of an insertion in the simulated world: its path [mm], and its distances from target and obstacles."""

    path_mm: tuple[_Point, ...] = ()
    target_mm: _Point | None = None
    true_obstacles: tuple[TrueObstacle, ...] = ()
    true_target_error_mm: float | None = None
    true_min_clearance_mm: float | None = None

    @property
    def path(self) -> FloatArray:
        """The path, (N, 3) [mm]."""
        return np.asarray(self.path_mm, dtype=np.float64).reshape(-1, 3)
