"""The insertion axis of a rig as its pictures find it, in closed form: where it stands when it is looked at.

It follows the drive's trapezoid, and stops for a new target only if that asks for it. Its position is read at the rate
of the recorded states, and a picture is taken at the first reading at which the commanded depth has been passed, as
the procedure does.
"""

from dataclasses import dataclass

from labrig.devices.axis_description import AxisDescription
from labrig.devices.trapezoid import Limits, Profile, make_move_profile, make_rest_profile
from labrig.experiments.insertion.settings import SAME_MM


@dataclass
class VirtualAxis:
    """An insertion axis that moves in simulated time.

    Attributes
    ----------
    description : AxisDescription
        Its section of the rig file.
    period_s : float
        Between two readings.
    """

    description: AxisDescription
    period_s: float

    def __post_init__(self) -> None:
        self._scale = self.description.scale()
        self._motion = make_rest_profile(0.0, 0.0)
        self._now_s = self._run_to_mm = 0.0

    @property
    def position_mm(self) -> float:
        """Where it stands now, in whole counts."""
        return self._read(self._motion.at(self._now_s)[0])

    def pass_depth(self, observe_at_mm: float, run_to_mm: float, speed_mm_s: float) -> float:
        """Run towards a depth, and return where it stands at the first reading beyond another, or at the end."""
        if abs(run_to_mm - self._run_to_mm) > SAME_MM:
            self._motion = self._start(run_to_mm, speed_mm_s)
            self._run_to_mm = run_to_mm
        passing = run_to_mm - observe_at_mm > SAME_MM
        self._now_s += self.period_s
        while self._now_s < self._motion.end_s and not (passing and self.position_mm >= observe_at_mm):
            self._now_s += self.period_s
        return self.position_mm

    def stand_at(self, position_mm: float) -> None:
        """Stand still at a position."""
        self._motion = make_rest_profile(self._now_s, self._read(position_mm))
        self._run_to_mm = position_mm

    def _start(self, to_mm: float, speed_mm_s: float) -> Profile:
        scale, position_mm, velocity = self._scale, *self._motion.at(self._now_s)
        speed = scale.to_speed(scale.to_speed_units(speed_mm_s))
        acceleration = self.description.acceleration
        limits = Limits(speed, acceleration, acceleration)
        return make_move_profile(self._now_s, position_mm, velocity, self._read(to_mm), limits)

    def _read(self, position_mm: float) -> float:
        return self._scale.to_position(self._scale.to_counts(position_mm))
