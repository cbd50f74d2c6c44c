"""Input and output of the steering step: policy, settings, sighting, command."""

import math
from dataclasses import dataclass
from typing import Literal, Self

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.steering.problem import PlanMethod, PlanProblem
from labrig.steering.tip import EstimatorSettings, freeze, require_numbers

StopReason = Literal[
    "target_reached", "target_missed", "blocked", "needle_lost", "needle_stuck", "sheath_astray"
]
_POSITIVE = frozenset(
    ["replan_every_mm", "observe_every_mm", "arrival_mm", "stuck_mm", "most_misses", "max_off_axis_rad"]
)


@dataclass(frozen=True)
class SteeringPolicy:
    """When the path is replanned, and the properties of the needle beyond its arcs.

    Parameters
    ----------
    replan_every_mm : float
    deviation_mm, deviation_share : float
        Replan if the rest of the path would miss the target by more than deviation_mm plus deviation_share times
        its length; infinite: a miss never causes a replan.
    near_mm, near_deviation_mm : float
        Within near_mm of the end, replan for a miss of more than near_deviation_mm.
    final_mm, final_error_per_mm : float
        Within final_mm of the target, take at every sighting the path that comes nearest to it; final_error_per_mm is
        the cost of a millimetre of miss against that of the turns.
    max_off_axis_rad : float
        Limit of the path's angle to the start's axis, if a path within it exists: a needle that leads far aside has
        no curvature left for corrections.
    observe_every_mm : float
    backlash_mm : float
        Length along which the curvature swings over after a turn of the bevel.
    closing_mm : float
        Length along which the hinges close after the start.
    lead_mm : float
        A turn that is planned while the needle moves is made no sooner than after this length.
    arrival_mm : float
        The needle stops when less than this is left of the path.
    most_misses : int
        The needle is lost after so many sightings in a row that are missing or rejected.
    stuck_mm : float
        The needle is stuck if it was inserted by this and its tip moved by less than half of it.
    least_clearance_mm : float
        If disturbances have used up the clearance, a path that keeps this much is taken.
    patience_mm : float
        The needle follows the old path for this length if that would miss and no new path is found.
    """

    replan_every_mm: float = 20.0
    deviation_mm: float = 0.4
    deviation_share: float = 0.02
    near_mm: float = 30.0
    near_deviation_mm: float = 0.2
    final_mm: float = 8.0
    final_error_per_mm: float = 40.0
    max_off_axis_rad: float = math.radians(50.0)
    observe_every_mm: float = 1.0
    backlash_mm: float = 1.5
    closing_mm: float = 3.0
    lead_mm: float = 0.2
    arrival_mm: float = 0.05
    most_misses: int = 8
    stuck_mm: float = 4.0
    least_clearance_mm: float = 0.2
    patience_mm: float = 15.0

    def __post_init__(self) -> None:
        """Refuse a length that is negative, or zero where it must be positive."""
        for name, value in vars(self).items():
            positive = name in _POSITIVE
            if not (value > 0 if positive else value >= 0):
                raise InputError(f"{name} is {value:g}, it must be {'above 0' if positive else '0 or more'}")

    @classmethod
    def paper(cls) -> Self:
        """Return the paper's policy: replan every 20 mm, let a turn act at once, and follow the plan to its end."""
        return cls(
            deviation_mm=math.inf,
            near_mm=0.0,
            final_mm=0.0,
            max_off_axis_rad=math.pi,
            backlash_mm=0.0,
            closing_mm=0.0,
        )


@dataclass(frozen=True)
class SteeringSettings:
    """The problem, how the tip is estimated, and the policy.

    Parameters
    ----------
    problem : PlanProblem
        As it is before the insertion; `start` is the tip's pose, and its roll that of the bevel.
    estimator : EstimatorSettings
    policy : SteeringPolicy
    method : {"best", "paper"}
        The planner.
    """

    problem: PlanProblem
    estimator: EstimatorSettings
    policy: SteeringPolicy = SteeringPolicy()
    method: PlanMethod = "best"

    def __post_init__(self) -> None:
        """Refuse a planner and a filter that disagree about the plane."""
        if self.problem.planar != self.estimator.planar:
            raise InputError("planner and estimator differ about planar", "set both or none")


@dataclass(frozen=True, eq=False)
class TipSighting:
    """An insertion length, and the tip's position seen there.

    Parameters
    ----------
    insertion_mm : float
        Length of needle inserted beyond the start.
    position_mm : (3,) array or None
        In the world frame; None if the tip was not found.
    """

    insertion_mm: float
    position_mm: FloatArray | None

    def __post_init__(self) -> None:
        """Refuse a value that is not finite."""
        if not math.isfinite(self.insertion_mm):
            raise InputError(f"insertion_mm is {self.insertion_mm:g}, it must be a number")
        if self.position_mm is not None:
            object.__setattr__(
                self, "position_mm", freeze(require_numbers("position_mm", self.position_mm, (3,)))
            )


@dataclass(frozen=True)
class SteeringCommand:
    """What to do next: stop, or turn the bevel, run on and look.

    Attributes
    ----------
    roll_rad : float
        Turn the bevel by this first, while the needle stands still; 0: no turn.
    observe_at_mm : float
        Insertion length at which to look next.
    run_to_mm : float
        Insertion length up to which the needle may run; it stops there for a turn or at the end of the path.
    stop : str or None
        Why the insertion ends here; None while it goes on.
    detail : str
        A sentence about it; empty while the needle goes on.
    """

    roll_rad: float
    observe_at_mm: float
    run_to_mm: float
    stop: StopReason | None = None
    detail: str = ""
