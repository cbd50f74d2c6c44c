"""What the steering step is told and what it answers: policy, settings, sighting, command."""

import math
from dataclasses import dataclass
from typing import Literal, Self

from labrig.errors import InputError
from labrig.steering.problem import PlanMethod, PlanProblem
from labrig.steering.tip import EstimatorSettings, FloatArray, frozen, numbers

StopReason = Literal[
    "target_reached", "target_missed", "blocked", "needle_lost", "needle_stuck", "sheath_astray"
]


@dataclass(frozen=True)
class SteeringPolicy:
    """When the path is planned anew, and what is known of the needle beyond its arcs.

    Parameters
    ----------
    replan_every_mm : float
    deviation_mm, deviation_share : float
        Plan anew where the path that is left would miss the target by more than the one and the other times what
        is left of it; infinite: never for that.
    near_mm, near_deviation_mm : float
        Where no more than this is left, plan anew for this miss.
    final_mm, final_error_per_mm : float
        Where the target is no farther than this, take at every sighting what comes nearest to it, a millimetre of
        miss having this price beside the turns.
    max_off_axis_rad : float
        Cap on the path's angle to the start's axis, wherever a path within it is found: a needle that leads far aside
        has nothing left to correct with.
    observe_every_mm : float
    backlash_mm : float
        Length along which the curvature swings over after a turn of the bevel.
    closing_mm : float
        Length along which the hinges close after the start.
    lead_mm : float
        A turn that is found while the needle moves is made no sooner than after this length.
    arrival_mm : float
        What is left of a path is no longer driven below this.
    most_misses : int
        So many sightings in a row without a tip, or with one that is not believed, and the needle is lost.
    stuck_mm : float
        The needle is stuck where it was inserted by this and its tip seen to move by less than half of it.
    least_clearance_mm : float
        Where no path keeps the clearance asked for, disturbances having used it up, one is taken that keeps this.
    patience_mm : float
        So far the old path is followed where no new one is found and the old one would miss.
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
        """Refuse what is no length."""
        positive = (
            "replan_every_mm",
            "observe_every_mm",
            "arrival_mm",
            "stuck_mm",
            "most_misses",
            "max_off_axis_rad",
        )
        for name, value in vars(self).items():
            if not (value > 0 if name in positive else value >= 0):
                limit = "above 0" if name in positive else "0 or more"
                raise InputError(f"{name} is {value:g}, it must be {limit}")

    @classmethod
    def paper(cls) -> Self:
        """Return the paper's: plan anew every 20 mm, as if a turn acted at once, and follow the plan to its end."""
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
    """What is to be reached and around what, how the tip is estimated, and the policy.

    Parameters
    ----------
    problem : PlanProblem
        As it stands before the insertion; `start` is the tip's pose, its roll the bevel's.
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
        """Refuse a planner and a filter that do not speak of the same needle."""
        if self.problem.planar != self.estimator.planar:
            raise InputError("planner and estimator differ about planar", "set both or none")


@dataclass(frozen=True, eq=False)
class TipSighting:
    """An insertion length, and where the tip was seen there.

    Parameters
    ----------
    insertion_mm : float
        How far the needle has been inserted beyond the start.
    position_mm : (3,) array or None
        In the world frame; None where the tip was not found.
    """

    insertion_mm: float
    position_mm: FloatArray | None

    def __post_init__(self) -> None:
        """Refuse what is no number."""
        if not math.isfinite(self.insertion_mm):
            raise InputError(f"insertion_mm is {self.insertion_mm:g}, it must be a number")
        if self.position_mm is not None:
            object.__setattr__(self, "position_mm", frozen(numbers("position_mm", self.position_mm, (3,))))


@dataclass(frozen=True)
class SteeringCommand:
    """What to do next: stop, or turn the bevel, then run on and look.

    Attributes
    ----------
    roll_rad : float
        Turn the bevel by this first, the needle standing; 0: do not.
    observe_at_mm : float
        Insertion length at which to look next.
    run_to_mm : float
        Insertion length up to which the needle may run; there it stands, as a turn or the end of the path follows.
    stop : str or None
        Why the needle stops here; None while it goes on.
    detail : str
        A sentence about it; empty while the needle goes on.
    """

    roll_rad: float
    observe_at_mm: float
    run_to_mm: float
    stop: StopReason | None = None
    detail: str = ""
