"""The weights of the planner in protocols and scenarios; the defaults are those of `steering`."""

from typing import Annotated, TypeAlias

from pydantic import Field

from labrig.protocol.model import Model, NonNegativeMm
from labrig.steering.parameters import PlanWeights

Weight: TypeAlias = Annotated[float, Field(ge=0, le=1000)]

_DEFAULT = PlanWeights()


class PlannerWeights(Model):
    """What makes one feasible path better than another; the smallest sum wins."""

    length_per_mm: Weight = _DEFAULT.length_per_mm
    """Cost of a millimetre of path."""
    turn: Weight = _DEFAULT.turn
    """Cost of an arc."""
    target_error_per_mm: Weight = _DEFAULT.target_error_per_mm
    """Cost of each millimetre beside the target."""
    clearance_per_mm: Weight = _DEFAULT.clearance_per_mm
    """Cost of each millimetre missing to a comfortable clearance."""
    comfortable_clearance_mm: NonNegativeMm = _DEFAULT.comfortable_clearance_mm
    """Clearance beyond which more is no better [mm]."""
    curvature_per_mm: Weight = _DEFAULT.curvature_per_mm
    """Cost of each millimetre by which the worst radius of its tolerance moves the tip; without a tolerance,
    a radius one per cent larger."""
    room_per_mm: Weight = _DEFAULT.room_per_mm
    """Cost, in the plane, of each millimetre missing to a comfortable room: the clearance from an obstacle
    that the needle would have if it bent away from it at once."""
    comfortable_room_mm: NonNegativeMm = _DEFAULT.comfortable_room_mm
    """Room beyond which more is no better [mm]."""
