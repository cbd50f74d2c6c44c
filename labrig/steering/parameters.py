"""What a protocol says about planning, estimating and steering: its sections are the settings. It loads no numpy."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import Field

from labrig.protocol.model import Conflict, Model, NonNegativeMm, PositiveMm

Turning: TypeAlias = Literal["compensated", "back_and_forth"]
"""How the bevel is turned against torsion: see `labrig.steering.torsion`."""

PlanMethod: TypeAlias = Literal["best", "paper"]
EstimatorMethod: TypeAlias = Literal["error-state", "paper"]
Weight: TypeAlias = Annotated[float, Field(ge=0, le=1000)]


class PlanWeights(Model):
    """What makes one feasible path better than another; the smallest sum wins."""

    length_per_mm: Weight = 1.0
    """Cost of a millimetre of path."""
    turn: Weight = 4.0
    """Cost of an arc."""
    target_error_per_mm: Weight = 10.0
    """Cost of each millimetre beside the target."""
    clearance_per_mm: Weight = 6.0
    """Cost of each millimetre missing to a comfortable clearance."""
    comfortable_clearance_mm: NonNegativeMm = 3.0
    """Clearance beyond which more is no better [mm]."""
    curvature_per_mm: Weight = 4.0
    """Cost of each millimetre by which the worst radius of its tolerance moves the tip; without a tolerance, a
    radius one per cent larger."""
    room_per_mm: Weight = 6.0
    """Cost, in the plane, of each millimetre missing to a comfortable room: the clearance from an obstacle that
    the needle would have if it bent away from it at once."""
    comfortable_room_mm: NonNegativeMm = 6.0
    """Room beyond which more is no better [mm]."""


class Estimator(Model):
    """How the tip's pose is estimated from its observed positions."""

    method: EstimatorMethod = "error-state"
    """The default, an error-state Kalman filter, or the paper's for comparison."""
    observation_sd_mm: PositiveMm = 0.2
    """Standard deviation of an observed tip position, along each axis [mm]."""
    process_sd_deg_per_root_mm: float = Field(0.4, ge=0, le=10)
    """Random turning of the tip after a millimetre [deg / mm^0.5]."""
    radius_sd_mm: NonNegativeMm = 0.6
    """Standard deviation of radius_mm before the needle was seen; 0: the radius is not estimated [mm]."""
    start_sd_deg: float = Field(1.0, ge=0, le=20)
    """Standard deviation of the sheath's direction [deg]."""
    cavity_every_mm: PositiveMm | None = 50.0
    """Mean path length between cavities, in which the needle does not steer; null: cavities are not modelled
    [mm]."""
    slip_sd: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    """Standard deviation of the slip, the share of the inserted length by which the tip stays behind; 0: the slip
    is not estimated. The paper's filter does not estimate it [-]."""

    @property
    def process_sd_rad_per_root_mm(self) -> float:
        """Random turning of the tip after a millimetre [rad / mm^0.5]."""
        return math.radians(self.process_sd_deg_per_root_mm)

    @property
    def start_sd_rad(self) -> float:
        """Standard deviation of the sheath's direction [rad]."""
        return math.radians(self.start_sd_deg)

    def conflicts(self) -> Iterator[Conflict]:
        """Yield keys that the paper's filter cannot use."""
        if self.method == "paper" and self.radius_sd_mm > 0:
            message = (
                f"radius_sd_mm is {self.radius_sd_mm:g}, but the paper's filter takes the radius as known"
            )
            yield Conflict("radius_sd_mm", message, "set it to 0, or use the error-state filter")
        if self.method == "paper" and self.cavity_every_mm is not None:
            message = (
                f"cavity_every_mm is {self.cavity_every_mm:g}, but the paper's filter does not model cavities"
            )
            yield Conflict("cavity_every_mm", message, "set it to null, or use the error-state filter")


class SteeringPolicy(Model):
    """When the path is replanned, when the insertion is given up, and how the hinges respond to a turn."""

    replan_every_mm: PositiveMm = 20.0
    """Replan after this much insertion [mm]."""
    deviation_mm: NonNegativeMm | None = 0.4
    """Replan if the rest of the path would miss by more; null: never for that reason [mm]."""
    DEVIATION_SHARE: ClassVar[float] = 0.02
    """The rest of the path may miss by this share of its length more."""
    near_mm: NonNegativeMm = 30.0
    """Replan for a smaller miss if no more than this is left [mm]."""
    NEAR_DEVIATION_MM: ClassVar[float] = 0.2
    """That smaller miss."""
    final_mm: NonNegativeMm = 8.0
    """Take the path that comes nearest to the target, anew at every picture, if no more than this is left [mm]."""
    backlash_mm: NonNegativeMm = 1.5
    """Insertion over which the curvature reverses after half a turn [mm]."""
    closing_mm: NonNegativeMm = 3.0
    """Insertion over which the hinges close at the start [mm]."""
    most_misses: int = Field(8, ge=1, le=1000)
    """Stop the needle after this many pictures in a row without a credible tip."""
    stuck_mm: PositiveMm = 4.0
    """Stop the needle after inserting this much without the tip advancing [mm]."""
    least_clearance_mm: NonNegativeMm = 0.2
    """If no path keeps clearance_mm, take a path that keeps this [mm]."""
    max_off_axis_deg: Annotated[float, Field(gt=0, le=180)] = 50.0
    """Largest angle between a path and its direction at the start, if a path within it exists: a needle that leads
    far aside has no curvature left for corrections. The paper has no limit [deg]."""
    turning: Turning = "compensated"
    """How the bevel is turned against torsion of the needle: compensated, in the direction whose lag displaces the tip
    least, past the wanted angle by the measured lag and back; back_and_forth, half a turn and back."""

    def find_acting_mm(self, made_at_mm: float) -> float:
        """Return the insertion length at which a turn of the bevel made at a length acts."""
        return max(made_at_mm + self.backlash_mm / 2, self.closing_mm / 2)


PAPER_POLICY = SteeringPolicy(
    deviation_mm=None,
    near_mm=0.0,
    final_mm=0.0,
    backlash_mm=0.0,
    closing_mm=0.0,
    max_off_axis_deg=180.0,
    turning="back_and_forth",
)
"""The paper's policy: replan every 20 mm, let a turn act at once, and follow the plan to its end."""

PAPER_SECTIONS: Mapping[str, Mapping[str, object]] = {
    "planner": {"method": "paper"},
    "estimator": {"method": "paper", "radius_sd_mm": 0.0, "cavity_every_mm": None, "slip_sd": 0.0},
}
"""What `policy: paper` says beyond its own section: section -> key -> value."""
SECTIONS = {"estimator": Estimator.model_fields, "policy": SteeringPolicy.model_fields}
"""What a protocol says of how to steer: section -> key -> its field."""
