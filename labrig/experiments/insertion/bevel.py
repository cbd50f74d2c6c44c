"""The bevel of a needle that is being inserted: the rotation axis turns it as its path says."""

from dataclasses import dataclass
from functools import cached_property

from labrig.devices.needle_state import RollZero
from labrig.experiments.insertion.bevel_path import BevelPath
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.runner.session import Session
from labrig.steering.state import SteeringState
from labrig.steering.torsion import BaseLimits


@dataclass
class Bevel:
    """The bevel of one insertion: its path, and the axis that turns it."""

    protocol: InsertionProtocol
    session: Session
    roll_zero: RollZero
    trial: int

    @cached_property
    def path(self) -> BevelPath:
        """How it was turned."""
        zero_rad = self.roll_zero.zero_rad
        return BevelPath(
            trial=self.trial,
            zero_rad=zero_rad,
            lag=self.roll_zero.lag,
            limits=BaseLimits.of_axis(self.session.axis("rotation").limits, zero_rad),
            turning=self.protocol.policy.turning,
            radius_mm=self.protocol.planner.radius_mm,
        )

    def centre(self) -> None:
        """Turn to the roll zero while the needle is in the sheath."""
        rotation, zero_rad = self.session.axis("rotation"), self.roll_zero.zero_rad
        if self.path.turning == "compensated":
            turn = self.path.centre(self.session.read_positions().rotation_rad - zero_rad)
            if turn.overshoot_rad:
                self.session.move("rotation", zero_rad + turn.farthest_rad, rotation.max_speed / 2)
        self.session.move("rotation", zero_rad, rotation.max_speed / 2)

    def turn(self, roll_rad: float, state: SteeringState, depth_mm: float) -> None:
        """Turn while the needle stands still."""
        rotation, zero_rad = self.session.axis("rotation"), self.roll_zero.zero_rad
        turn, event = self.path.turn(roll_rad, state, depth_mm)
        self.session.record(event)
        speed = rotation.nearest_speed(rotation.max_speed)
        if turn.overshoot_rad:
            self.session.move("rotation", zero_rad + turn.farthest_rad, speed)
            self.session.wait(rotation.lag_s)
        self.session.move("rotation", zero_rad + turn.to_rad, speed)
        self.session.wait(rotation.lag_s)
