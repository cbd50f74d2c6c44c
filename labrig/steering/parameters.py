"""Weights of the planner and policy of the steering step. Protocols take defaults from here, so it loads no numpy."""

import math
from dataclasses import dataclass
from typing import Literal, Self

from labrig.errors import InputError

Turning = Literal["compensated", "back_and_forth"]
"""How the bevel is turned against torsion: see `labrig.steering.torsion`."""

_POSITIVE = frozenset(
    ["replan_every_mm", "observe_every_mm", "arrival_mm", "stuck_mm", "most_misses", "max_off_axis_rad"]
)


@dataclass(frozen=True)
class PlanWeights:
    """What makes one feasible path better than another; the smallest sum wins.

    Parameters
    ----------
    length_per_mm, turn, target_error_per_mm : float
        Cost of a millimetre of path, of a turn between arcs, and of a millimetre by which the tip misses the target.
    clearance_per_mm, comfortable_clearance_mm : float
        Cost of each millimetre that a comfortable clearance lacks.
    curvature_per_mm : float
        Cost of each millimetre by which the tip moves if the radius is the worst of its tolerance, or one per cent
        larger if the problem states no tolerance.
    cavity_per_mm : float
        Cost of each millimetre by which the tip would miss after a cavity, averaged over its place on the path.
    room_per_mm, comfortable_room_mm : float
        Cost, in the plane, of each millimetre that a comfortable room lacks: the clearance that the needle would have
        if it bent away from the obstacle from here on (`labrig.steering.room`).
    """

    length_per_mm: float = 1.0
    turn: float = 4.0
    target_error_per_mm: float = 10.0
    clearance_per_mm: float = 6.0
    comfortable_clearance_mm: float = 3.0
    curvature_per_mm: float = 4.0
    cavity_per_mm: float = 20.0
    room_per_mm: float = 6.0
    comfortable_room_mm: float = 6.0


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
