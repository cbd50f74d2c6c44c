"""Measure the torsion of a needle: by how much the bevel stays behind the rotation axis, by depth.

In each hole the needle goes in by arcs to one side and the other. At a depth the bevel is turned to 90 degrees from the
roll zero, in one hole from below and in the next from above, and goes on. A lag lets it bend in the plane, to opposite
sides. The turn begins half a turn away from its end, so that the bevel follows it however far it was behind.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from labrig.devices.axis_positions import AxisPositions
from labrig.devices.operator import ShiftToHole
from labrig.errors import MeasurementRefusedError
from labrig.experiments.shared.roll_zero_events import RollZeroRole, TorsionFound, TorsionHole, explain_doubt
from labrig.experiments.shared.torsion_bends import find_lengths, list_arcs_mm, measure_bend
from labrig.protocol.sections import RollZeroSearch, RollZeroSteps, TorsionSteps
from labrig.runner.session import Session
from labrig.runner.sight import Sight, TakenPicture
from labrig.runner.withdrawal import find_speeds, withdraw
from labrig.steering.torsion import BaseLimits, RolledStretch, TorsionalLag, TurnAhead, choose_turn
from labrig.steering.torsion_fit import TorsionBend, fit_torsion

DIRECTIONS = (1, -1)
_QUARTER_RAD = math.pi / 2


def measure_torsion(
    protocol: RollZeroSearch, steps: RollZeroSteps, zero_rad: float, sight: Sight, session: Session
) -> TorsionalLag | None:
    """Insert the needle at each depth from both sides, and return the fitted lag; None if it is not asked for.

    Raises
    ------
    MeasurementRefusedError
        When a picture does not show the needle, the bends do not fit it, or the lag is too uncertain.
    """
    if steps.torsion is None:
        return None
    holes = [(depth_mm, direction) for depth_mm in steps.torsion.depths_mm for direction in DIRECTIONS]
    bends = []
    for number, (depth_mm, direction) in enumerate(holes):
        session.tell(f"torsion, {number + 1} of {len(holes)}")
        hole = steps.rolls + number
        session.ask(ShiftToHole(steps.specimen.name, hole, hole * steps.hole_spacing_mm))
        probe = _Probe(protocol, steps.torsion, zero_rad, session)
        bends.append(_measure_hole(probe, hole, depth_mm, direction, sight))
    fit = fit_torsion(bends, find_lengths(steps.torsion), protocol.expected_radius_mm)
    session.record(TorsionFound(needle_id=protocol.needle.needle_id, fit=fit))
    if doubt := explain_doubt("the torsional lag", fit.sd_rad, steps.torsion.max_sd_deg):
        raise MeasurementRefusedError(
            doubt, "measure at more depths or go on further, and look at the pictures"
        )
    return fit.lag


def _measure_hole(probe: "_Probe", hole: int, depth_mm: float, direction: int, sight: Sight) -> TorsionBend:
    """Insert into a fresh hole, withdraw, and return the deflections before and after the turn."""
    protocol, session = probe.protocol, probe.session
    turn, end = probe.insert(depth_mm, direction)
    withdraw(session, probe.path, find_speeds(session.description, protocol.insertion, protocol.sheath))
    made = TorsionHole(
        hole=hole, depth_mm=depth_mm, direction=direction, turn_frame=turn.frame, end_frame=end.frame
    )
    session.record(made)
    shafts = [
        session.compute(
            partial(sight.measure_end, taken, protocol.needle.diameter_mm, protocol.sheath.diameter_mm)
        )
        for taken in (turn, end)
    ]
    return measure_bend(made, *shafts)


@dataclass
class _Probe:
    """One insertion for the torsion, and its path so far."""

    protocol: RollZeroSearch
    steps: TorsionSteps
    zero_rad: float
    session: Session
    path: list[AxisPositions] = field(default_factory=list)
    base_rad: float = 0.0

    def insert(self, depth_mm: float, direction: int) -> tuple[TakenPicture, TakenPicture]:
        """Insert to a depth, turn to 90 degrees in a direction, go on, and return the pictures at turn and end."""
        arcs_mm = list_arcs_mm(depth_mm)
        self._turn(self._fit_in(0.0 if len(arcs_mm) % 2 else math.pi))
        self.session.move("linear", self.protocol.sheath.depth_mm, self.protocol.sheath.speed_mm_s)
        rolled: list[RolledStretch] = []
        for number, arc_mm in enumerate(arcs_mm):
            turned = 0
            if number:
                turned = self._turn_over(rolled, arcs_mm[number:])
            rolled.append(RolledStretch(arc_mm, self.base_rad, turned))
            if number < len(arcs_mm) - 1:
                self._advance(sum(arcs_mm[: number + 1]))
        self._advance(depth_mm)
        turn = self.session.take_picture(RollZeroRole.TORSION_TURN)
        side_rad = self.base_rad + _QUARTER_RAD
        self._turn(side_rad - direction * math.pi)
        self._turn(side_rad)
        self._advance(depth_mm + self.steps.further_mm)
        return turn, self.session.take_picture(RollZeroRole.TORSION_END)

    def _turn_over(self, rolled: Sequence[RolledStretch], arcs_mm: Sequence[float]) -> int:
        """Turn the bevel by half a turn so that the needle stays near the plane, and return the direction."""
        turn = choose_turn(
            rolled,
            self.base_rad,
            [TurnAhead(math.pi, arc_mm) for arc_mm in arcs_mm],
            TorsionalLag(),
            self._limits,
            radius_mm=self.protocol.expected_radius_mm,
        )
        self._turn(turn.to_rad)
        return turn.direction

    def _turn(self, base_rad: float) -> None:
        """Turn the base to an angle from the roll zero."""
        rotation = self.session.axis("rotation")
        self.session.move("rotation", self.zero_rad + base_rad, rotation.max_speed / 2)
        self.session.wait(rotation.lag_s)
        self.base_rad = base_rad
        self.path.append(self.session.read_positions())

    def _advance(self, to_mm: float) -> None:
        self.session.move("insertion", to_mm, self.protocol.insertion.speed_mm_s)
        self.path.append(self.session.read_positions())

    def _fit_in(self, base_rad: float) -> float:
        """Return an angle, modulo a full turn, in the middle of the limits for the arcs."""
        middle_rad = 0.5 * (self._limits.low_rad + self._limits.high_rad)
        return base_rad + 2 * math.pi * round((middle_rad - base_rad) / (2 * math.pi))

    @property
    def _limits(self) -> BaseLimits:
        """The limits of the base for the arcs, from which the turns to 90 degrees are within the axis' limits."""
        axis = BaseLimits.of_axis(self.session.axis("rotation").limits, self.zero_rad)
        return BaseLimits(axis.low_rad + _QUARTER_RAD, axis.high_rad - 3 * _QUARTER_RAD)
