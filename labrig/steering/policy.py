"""Input and output of the steering step: settings, sighting, command."""

from dataclasses import dataclass, field
from typing import Literal

from labrig.needle.kinematics import FloatArray
from labrig.steering.parameters import PlanMethod, SteeringPolicy
from labrig.steering.problem import PlanProblem
from labrig.steering.tip import EstimatorSettings

StopReason = Literal[
    "target_reached",
    "target_missed",
    "blocked",
    "needle_lost",
    "needle_stuck",
    "sheath_astray",
    "marker_lost",
    "marker_jumped",
]


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
    observe_every_mm : float
        Inserted length between two sightings.
    """

    problem: PlanProblem
    estimator: EstimatorSettings
    policy: SteeringPolicy = field(default_factory=SteeringPolicy)
    method: PlanMethod = "best"
    observe_every_mm: float = 1.0


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


@dataclass(frozen=True)
class Halt:
    """Why a needle has to stop that is not seen from its tip, and a sentence about it."""

    reason: StopReason
    detail: str


@dataclass(frozen=True)
class SteeringCommand:
    """What to do next: stop, or or turn the bevel, advance, and take a picture.

    Attributes
    ----------
    roll_rad : float
        Turn the bevel by this first, while the needle stands still; 0: no turn.
    observe_at_mm : float
        Insertion length at which to take the next picture.
    run_to_mm : float
        Insertion length up to which the needle may advance; it stops there for a turn or at the end of the path.
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
