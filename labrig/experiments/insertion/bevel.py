"""The bevel of a needle that is being inserted: how the rotation axis turns it, and which turns it has made."""

from dataclasses import dataclass, field, replace

from labrig.devices.needle_state import RollZero
from labrig.experiments.insertion.ending import list_turns
from labrig.experiments.insertion.events import BevelTurn, InsertionEvent, NeedleRetreat
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.runner.session import Session
from labrig.steering.out_of_plane import RolledStretch
from labrig.steering.state import SteeringState
from labrig.steering.torsion import BaseLimits, centre_bevel, plan_turn

_SAME_RAD = 0.01


@dataclass
class Bevel:
    """The bevel of one insertion.

    Attributes
    ----------
    base_rad : float
        Where the base stands, from the roll zero; also where the bevel is, as far as its lag is known.
    turned, centred : int
        The directions in which it was turned last, and to the roll zero; 0 if that is not known.
    way : list of InsertionEvent
        Its turns, and the retreats between them.
    rolled : list of RolledStretch
        Stretches between turns, without the present one.
    """

    protocol: InsertionProtocol
    session: Session
    roll_zero: RollZero
    trial: int
    base_rad: float = 0.0
    turned: int = 0
    centred: int = 0
    way: list[InsertionEvent] = field(default_factory=list)
    rolled: list[RolledStretch] = field(default_factory=list)

    @property
    def turns(self) -> tuple[BevelTurn, ...]:
        """Turns on the path that the needle lies in."""
        return list_turns(self.way)

    def centre(self) -> None:
        """Turn to the roll zero while the needle is in the sheath."""
        rotation, zero_rad = self.session.rig.rotation, self.roll_zero.zero_rad
        if self.protocol.policy.turning == "compensated":
            from_rad = self.session.rig.read_states()["rotation"].position - zero_rad
            turn = centre_bevel(from_rad, self.roll_zero.lag, self._limits)
            self.turned = turn.direction if turn.overshoot_rad or abs(from_rad) > _SAME_RAD else 0
            self.centred = self.turned
            if turn.overshoot_rad:
                self.session.move("rotation", zero_rad + turn.farthest_rad, rotation.max_speed / 2)
        self.session.move("rotation", zero_rad, rotation.max_speed / 2)

    def turn(self, roll_rad: float, state: SteeringState, depth_mm: float) -> None:
        """Turn while the needle stands still, in the direction that the protocol's `turning` leads to."""
        rotation, zero_rad = self.session.rig.rotation, self.roll_zero.zero_rad
        rolled = self._list_rolled(state.insertion_mm)
        turn = plan_turn(
            rolled,
            self.base_rad,
            state.list_turns(roll_rad),
            self.roll_zero.lag,
            self._limits,
            turning=self.protocol.policy.turning,
            radius_mm=self.protocol.planner.radius_mm,
        )
        event = BevelTurn(
            trial=self.trial,
            depth_mm=depth_mm,
            from_rad=zero_rad + self.base_rad,
            to_rad=zero_rad + turn.to_rad,
            overshoot_rad=turn.overshoot_rad,
        )
        self.session.record(event)
        self.way.append(event)
        self.rolled, self.turned, self.base_rad = rolled, turn.direction, turn.to_rad
        speed = rotation.nearest_speed(rotation.max_speed)
        if turn.overshoot_rad:
            self.session.move("rotation", zero_rad + turn.farthest_rad, speed)
            self.session.rig.wait(rotation.lag_s)
        self.session.move("rotation", zero_rad + turn.to_rad, speed)
        self.session.rig.wait(rotation.lag_s)

    def follow_retreat(self, retreat: NeedleRetreat) -> None:
        """Forget the turns beyond where a withdrawn needle leaves its old cut; it was turned back on the way there."""
        self.way.append(retreat)
        kept, since_mm, turned_rad = list[RolledStretch](), 0.0, self.base_rad
        for stretch in self._list_rolled(retreat.from_mm):
            if since_mm >= retreat.leave_mm:
                break
            kept.append(replace(stretch, length_mm=min(stretch.length_mm, retreat.leave_mm - since_mm)))
            since_mm += stretch.length_mm
        self.rolled, self.base_rad = kept, kept[-1].roll_rad
        if self.base_rad != turned_rad:
            self.turned = 1 if self.base_rad > turned_rad else -1

    def _list_rolled(self, to_mm: float) -> list[RolledStretch]:
        """Return the stretches between turns, the present one included."""
        since_mm = sum(stretch.length_mm for stretch in self.rolled)
        return [*self.rolled, RolledStretch(max(0.0, to_mm - since_mm), self.base_rad, self.turned)]

    @property
    def _limits(self) -> BaseLimits:
        """The limits of the rotation axis, from the roll zero."""
        return BaseLimits.of_axis(self.session.rig.rotation.limits, self.roll_zero.zero_rad)
