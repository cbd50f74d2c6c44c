"""The bevel of a needle that is being inserted: how it was turned, and how the rotation axis turns it next."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from labrig.devices.needle_state import RollZero
from labrig.experiments.insertion.ending import trace_path
from labrig.experiments.insertion.events import BevelTurn
from labrig.runner.session import Session
from labrig.steering.parameters import Turning
from labrig.steering.planner import Plan
from labrig.steering.state import SteeringState
from labrig.steering.torsion import BaseLimits, BaseTurn, RolledStretch, TurnAhead, centre_bevel, choose_turn

_SAME_RAD = 0.01


@dataclass
class Bevel:
    """The bevel on the way of one insertion.

    Attributes
    ----------
    session : Session
        Its rotation axis turns the base.
    trial : int
        The number of the trial.
    roll_zero : RollZero
        Where the rotation axis stands at the roll zero, and the measured lag of the bevel behind the base.
    turning : str
        The protocol's key.
    radius_mm : float
        Expected of the needle's arcs.
    centred : int
        The direction in which it was turned to the roll zero; 0 if that is not known.
    turns : list of BevelTurn
        The turns that were made.
    """

    session: Session
    trial: int
    roll_zero: RollZero
    turning: Turning
    radius_mm: float
    centred: int = 0
    turns: list[BevelTurn] = field(default_factory=list)

    @property
    def base_rad(self) -> float:
        """Where the base stands, from the roll zero; also where the bevel is, as far as its lag is known."""
        return self.turns[-1].to_rad - self.roll_zero.zero_rad if self.turns else 0.0

    @property
    def _limits(self) -> BaseLimits:
        return BaseLimits.of_axis(self.session.axis("rotation").limits, self.roll_zero.zero_rad)

    def centre(self) -> None:
        """Turn to the roll zero while the needle is in the sheath, past it by the lag."""
        rotation, zero_rad = self.session.axis("rotation"), self.roll_zero.zero_rad
        if self.turning == "compensated":
            from_rad = self.session.read_positions().rotation_rad - zero_rad
            turn = centre_bevel(from_rad, self.roll_zero.lag, self._limits)
            self.centred = turn.direction if turn.overshoot_rad or abs(from_rad) > _SAME_RAD else 0
            if turn.overshoot_rad:
                self.session.move("rotation", zero_rad + turn.farthest_rad, rotation.max_speed / 2)
        self.session.move("rotation", zero_rad, rotation.max_speed / 2)

    def turn(self, roll_rad: float, state: SteeringState, depth_mm: float) -> None:
        """Turn by an angle at a depth, in the direction that `turning` leads to, while the needle stands still."""
        session, rotation, zero_rad = self.session, self.session.axis("rotation"), self.roll_zero.zero_rad
        path = trace_path(self.turns, zero_rad, state.insertion_mm, self.centred)
        turn = self.choose(roll_rad, state, path)
        event = BevelTurn(
            trial=self.trial,
            depth_mm=depth_mm,
            from_rad=zero_rad + self.base_rad,
            to_rad=zero_rad + turn.to_rad,
            overshoot_rad=turn.overshoot_rad,
        )
        self.turns.append(event)
        session.record(event)
        speed = rotation.nearest_speed(rotation.max_speed)
        if turn.overshoot_rad:
            session.move("rotation", zero_rad + turn.farthest_rad, speed)
            session.wait(rotation.lag_s)
        session.move("rotation", zero_rad + turn.to_rad, speed)
        session.wait(rotation.lag_s)

    def choose(self, roll_rad: float, state: SteeringState, rolled: Sequence[RolledStretch]) -> BaseTurn:
        """Return the turn of the base that turns the bevel by an angle after these stretches."""
        return self._choose(rolled, self.base_rad, state.list_turns(roll_rad))

    def foresee(self, path: Plan) -> list[RolledStretch]:
        """Return the arcs of a path with the directions in which the bevel will be turned before them."""
        ahead = [TurnAhead(arc.roll_rad, arc.length_mm) for arc in path.arcs]
        base_rad, turned, rolled = 0.0, 0, list[RolledStretch]()
        for number, arc in enumerate(ahead):
            if arc.roll_rad != 0.0:
                turn = self._choose(rolled, base_rad, ahead[number:])
                base_rad, turned = turn.to_rad, turn.direction
            rolled.append(RolledStretch(arc.length_mm, base_rad, turned))
        return rolled

    def _choose(
        self, rolled: Sequence[RolledStretch], base_rad: float, turns: Sequence[TurnAhead]
    ) -> BaseTurn:
        lag, limits, radius_mm = self.roll_zero.lag, self._limits, self.radius_mm
        return choose_turn(rolled, base_rad, turns, lag, limits, radius_mm=radius_mm, turning=self.turning)
