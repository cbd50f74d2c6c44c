"""How the base of a needle's bevel was turned on its way, and how it is turned next; this moves nothing."""

from dataclasses import dataclass, field

from labrig.experiments.insertion.events import BevelTurn
from labrig.steering.out_of_plane import RolledStretch
from labrig.steering.parameters import Turning
from labrig.steering.state import SteeringState
from labrig.steering.torsion import BaseLimits, BaseTurn, TorsionalLag, centre_bevel, plan_turn

_SAME_RAD = 0.01


@dataclass
class BevelPath:
    """The bevel on the way of one insertion.

    Attributes
    ----------
    trial : int
        The number of the trial.
    zero_rad : float
        Position of the rotation axis at the roll zero.
    lag : TorsionalLag
        Of the bevel behind the base, as it was measured.
    limits : BaseLimits
        Of the rotation axis, from the roll zero.
    turning : str
        The protocol's key.
    radius_mm : float
        Expected of the needle's arcs.
    base_rad : float
        Where the base stands, from the roll zero; also where the bevel is, as far as its lag is known.
    turned, centred : int
        The directions in which it was turned last, and to the roll zero; 0 if that is not known.
    turns : list of BevelTurn
        The turns that were made.
    rolled : list of RolledStretch
        Stretches between turns, without the present one.
    """

    trial: int
    zero_rad: float
    lag: TorsionalLag
    limits: BaseLimits
    turning: Turning
    radius_mm: float
    base_rad: float = 0.0
    turned: int = 0
    centred: int = 0
    turns: list[BevelTurn] = field(default_factory=list)
    rolled: list[RolledStretch] = field(default_factory=list)

    def centre(self, from_rad: float) -> BaseTurn:
        """Return how the base is turned from an angle to the roll zero, past it by the lag, in the sheath."""
        turn = centre_bevel(from_rad, self.lag, self.limits)
        self.turned = turn.direction if turn.overshoot_rad or abs(from_rad) > _SAME_RAD else 0
        self.centred = self.turned
        return turn

    def turn(self, roll_rad: float, state: SteeringState, depth_mm: float) -> tuple[BaseTurn, BevelTurn]:
        """Turn by an angle at a depth, in the direction that `turning` leads to; return the turn and its event."""
        rolled = self.list_rolled(state.insertion_mm)
        turn = self.choose(roll_rad, state, rolled)
        event = BevelTurn(
            trial=self.trial,
            depth_mm=depth_mm,
            from_rad=self.zero_rad + self.base_rad,
            to_rad=self.zero_rad + turn.to_rad,
            overshoot_rad=turn.overshoot_rad,
        )
        self.turns.append(event)
        self.rolled, self.turned, self.base_rad = rolled, turn.direction, turn.to_rad
        return turn, event

    def choose(self, roll_rad: float, state: SteeringState, rolled: list[RolledStretch]) -> BaseTurn:
        """Return the turn of the base that turns the bevel by an angle after these stretches."""
        return plan_turn(
            rolled,
            self.base_rad,
            state.list_turns(roll_rad),
            self.lag,
            self.limits,
            turning=self.turning,
            radius_mm=self.radius_mm,
        )

    def list_rolled(self, to_mm: float) -> list[RolledStretch]:
        """Return the stretches between turns, the present one included."""
        since_mm = sum(stretch.length_mm for stretch in self.rolled)
        return [*self.rolled, RolledStretch(max(0.0, to_mm - since_mm), self.base_rad, self.turned)]
