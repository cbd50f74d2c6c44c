"""Find the roll zero of a needle as it is clamped, from short insertions at rolls spread over a turn.

Deflections are measured from the sheath, found in each hole before the needle leaves it: its play does not count.
If the torsion is measured too, the rolls are turned to from either side in turns: a lag of the bevel then widens the
residuals and does not shift the zero.
"""

import math
from dataclasses import asdict, dataclass
from functools import partial

from labrig.analysis.origin import find_sheath, lateral_offset_mm
from labrig.analysis.result import TrialOrigin
from labrig.analysis.sentinel import GridRole
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.needle_state import RollZero
from labrig.devices.operator import ConfirmAxesAtZero, MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.devices.rig_file import RigDescription
from labrig.errors import MeasurementRefusedError
from labrig.experiments.shared.rig_view import load_plane_map, require_light
from labrig.experiments.shared.roll_zero_events import RollZeroFound, RollZeroRole, RollZeroSheath
from labrig.experiments.shared.torsion_measurement import TorsionOrder, measure_torsion
from labrig.protocol.sections import Advance, GridSentinel, Needle, RollZeroSteps, Sheath
from labrig.runner.experiment import PlannedMove
from labrig.runner.graph_paper import confirm_needle_out, photograph_grid, require_same_grid
from labrig.runner.plan import plan_insertion_moves, plan_roll_move
from labrig.runner.session import Session
from labrig.runner.withdrawal import find_speeds, withdraw
from labrig.steering.roll_zero import RollZeroFit, fit_roll_zero
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.plane import PlaneMap


@dataclass(frozen=True)
class RollZeroOrder:
    """What to find a roll zero for: the needle, the steps, and the expected radius."""

    needle: Needle
    sheath: Sheath
    advance: Advance
    steps: RollZeroSteps
    radius_mm: float
    sentinel: GridSentinel | None = None

    @property
    def duration_s(self) -> float:
        """The rig time of the search [s]."""
        torsion = self.torsion
        return self.rolls_duration_s + (0.0 if torsion is None else torsion.duration_s)

    @property
    def rolls_duration_s(self) -> float:
        """The part of it for the roll zero alone [s]."""
        one_s = self.steps.length_mm * (1 / self.advance.speed_mm_s + 1 / self.advance.withdraw_speed_mm_s)
        return self.steps.rolls * (one_s + 2 * self.sheath.depth_mm / self.sheath.speed_mm_s)

    @property
    def pictures(self) -> int:
        """The number of pictures: one of each insertion, one of the sheath before it, and those of the torsion."""
        torsion = self.torsion
        rolls = self.steps.rolls * (1 if self.sheath.origin is None else 2)
        return rolls + (0 if torsion is None else torsion.pictures)

    @property
    def holes(self) -> int:
        """The number of holes."""
        return self.steps.rolls + (0 if self.torsion is None else len(self.torsion.holes))

    @property
    def torsion(self) -> TorsionOrder | None:
        """What to measure the torsion with; None: it is not measured."""
        steps = self.steps.torsion
        if steps is None:
            return None
        return TorsionOrder(
            self.needle,
            self.sheath,
            self.advance,
            self.steps,
            steps,
            self.radius_mm,
            self.rolls_duration_s,
        )

    def plan_torsion_moves(self, rig: RigDescription) -> tuple[PlannedMove, ...]:
        """Return the farthest moves for the torsion; none if it is not measured.

        Within two turns of travel there is room for its turns, wherever the roll zero is.
        """
        if self.torsion is None:
            return ()
        key = "roll_zero.torsion"
        return (
            plan_roll_move(rig, key, -2 * math.pi),
            plan_roll_move(rig, key, 2 * math.pi),
            *plan_insertion_moves(f"{key}.depths_mm", self.torsion.deepest_mm, self.advance, self.sheath),
        )

    @property
    def rolls_rad(self) -> list[float]:
        """The rolls, spread evenly over a turn."""
        return [2 * math.pi * step / self.steps.rolls for step in range(self.steps.rolls)]

    @property
    def farthest_roll_rad(self) -> float:
        """The largest turn of the bevel from its first position [rad]."""
        return 2 * math.pi * (self.steps.rolls - 1) / self.steps.rolls


def find_roll_zero(order: RollZeroOrder, session: Session) -> RollZero:
    """Mount the needle, insert it at each roll, fit the cosine, and certify its peak in the rig's state.

    Raises
    ------
    MeasurementRefusedError
        When a sheath is out of place, a picture does not show the tip, the bend does not fit the needle,
        or the zero is too uncertain.
    CalibrationRefusedError
        When the camera was bumped during the search.
    """
    steps = order.steps
    plane = session.compute(partial(load_plane_map, session.description))
    confirm_needle_out(session)
    session.ask(MountNeedle(order.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    session.reference_axes()
    before = photograph_grid(order.sentinel, GridRole.BEFORE, session)
    session.ask(PlaceSpecimen(steps.specimen.name, steps.specimen.gelatin_percent))
    rolls_rad = order.rolls_rad
    strays_mm = [_measure_stray_mm(order, step, roll, plane, session) for step, roll in enumerate(rolls_rad)]
    fit = fit_roll_zero(rolls_rad, strays_mm, steps.length_mm, order.radius_mm)
    session.record(
        RollZeroFound(
            needle_id=order.needle.needle_id,
            roll_rad=tuple(rolls_rad),
            deflection_mm=tuple(strays_mm),
            **asdict(fit),
        )
    )
    require_sure_zero(fit, steps)
    torsion = None if order.torsion is None else measure_torsion(order.torsion, fit.zero_rad, plane, session)
    after = photograph_grid(order.sentinel, GridRole.AFTER, session)
    require_same_grid(before, after, order.sentinel, plane, session)
    certified = RollZero(order.needle.needle_id, fit.zero_rad, fit.sd_rad, session.run_name, torsion)
    session.certify_roll_zero(certified)
    return certified


def require_sure_zero(fit: RollZeroFit, steps: RollZeroSteps) -> None:
    """Refuse a roll zero that is too uncertain. Raises `MeasurementRefusedError`."""
    if math.degrees(fit.sd_rad) > steps.max_sd_deg:
        raise MeasurementRefusedError(
            f"the roll zero is uncertain by {math.degrees(fit.sd_rad):.1f} degrees, and {steps.max_sd_deg:g} is the "
            "most that is certified",
            "insert at more rolls or further, and look at the pictures",
        )


def _measure_stray_mm(
    order: RollZeroOrder, step: int, roll_rad: float, plane: PlaneMap, session: Session
) -> float:
    """Insert at one roll into a fresh hole, withdraw, and return the lateral deflection of the tip [mm]."""
    steps, advance, rotation = order.steps, order.advance, session.axis("rotation")
    session.progress(step * order.rolls_duration_s / steps.rolls, f"roll zero, {step + 1} of {steps.rolls}")
    session.ask(ShiftToHole(steps.specimen.name, step, step * steps.hole_spacing_mm))
    if steps.torsion is not None:
        side = 1 if step % 2 else -1
        session.move("rotation", roll_rad - side * math.pi / 2, rotation.max_speed / 2)
    session.move("rotation", roll_rad, rotation.max_speed / 2)
    session.mark_needle_in_tissue()
    session.move("linear", order.sheath.depth_mm, order.sheath.speed_mm_s)
    origin = _find_sheath(order, step, plane, session)
    picture = None
    if origin is None or origin.accepted:
        session.move("insertion", steps.length_mm, advance.speed_mm_s)
        picture = session.take_picture(RollZeroRole.NEEDLE)
    path = (AxisPositions(0.0, roll_rad, order.sheath.depth_mm),)
    withdraw(session, path, find_speeds(session.description, advance, order.sheath))
    if picture is None:
        reason = "" if origin is None else (origin.reason or "")
        raise MeasurementRefusedError(reason.rstrip("."), "look at sheath, clamp and camera")
    settings = CurvatureSettings(order.needle.diameter_mm, order.sheath.diameter_mm)
    measured = session.compute(partial(measure_curvature, picture.image, plane, settings))
    if measured.tip_mm is None:
        raise MeasurementRefusedError(
            f"picture {picture.frame} does not show the needle: {measured.reason}",
            "look at it, mend the light",
        )
    return lateral_offset_mm(measured.tip_mm, origin)


def _find_sheath(order: RollZeroOrder, step: int, plane: PlaneMap, session: Session) -> TrialOrigin | None:
    """Find the sheath's pose before the needle leaves it; None if the protocol does not ask for it."""
    if order.sheath.origin is None:
        return None
    picture = session.take_picture(RollZeroRole.SHEATH)
    require_light(picture.image)
    linear_mm = picture.positions.linear_mm
    origin = session.compute(
        partial(find_sheath, picture.image, plane, order.sheath, linear_mm, trial=step, frame=picture.frame)
    )
    session.record(RollZeroSheath(origin=origin))
    return origin
