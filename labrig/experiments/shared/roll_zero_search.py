"""Find the roll zero of a needle as it is clamped, from short insertions at rolls spread over a turn.

Deflections are measured from the sheath, found in each hole before the needle leaves it: its play does not count.
The shift by which a tip out of the plane is seen is taken out.
If the torsion is measured too, the rolls are turned to from either side in turns: a lag of the bevel then widens the
residuals and does not shift the zero.
"""

import math
from functools import partial

from labrig.analysis.origin import lateral_offset_mm
from labrig.analysis.result import TrialOrigin
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.needle_state import RollZero
from labrig.devices.operator import ConfirmAxesAtZero, MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.errors import MeasurementRefusedError
from labrig.experiments.shared.roll_zero_events import (
    RollZeroFound,
    RollZeroRole,
    RollZeroSheath,
    explain_doubt,
)
from labrig.experiments.shared.torsion_measurement import measure_torsion
from labrig.protocol.sections import RollZeroSearch, RollZeroSteps
from labrig.runner.session import Session
from labrig.runner.sight import Sight
from labrig.runner.withdrawal import confirm_needle_out, find_speeds, withdraw
from labrig.steering.roll_zero import correct_perspective, fit_roll_zero
from labrig.vision.out_of_plane import Perspective


def find_roll_zero(
    protocol: RollZeroSearch, steps: RollZeroSteps, session: Session, sight: Sight
) -> RollZero:
    """Mount the needle, insert it at each roll, fit the cosine, and return its peak, which the caller certifies.

    Raises
    ------
    MeasurementRefusedError
        When a sheath is out of place, a picture does not show the tip, the bend does not fit the needle,
        or the zero is too uncertain.
    """
    confirm_needle_out(session)
    session.ask(MountNeedle(protocol.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    session.reference_axes()
    session.ask(PlaceSpecimen(steps.specimen.name, steps.specimen.gelatin_percent))
    rolls_rad = [2 * math.pi * step / steps.rolls for step in range(steps.rolls)]
    seen_mm = [_measure_stray_mm(protocol, steps, step, sight, session) for step in range(steps.rolls)]
    strays_mm = correct_perspective(rolls_rad, seen_mm, Perspective.of(sight.plane))
    fit = fit_roll_zero(rolls_rad, strays_mm, steps.length_mm, protocol.expected_radius_mm)
    session.record(
        RollZeroFound(
            needle_id=protocol.needle.needle_id,
            roll_rad=tuple(rolls_rad),
            deflection_mm=tuple(strays_mm),
            fit=fit,
        )
    )
    if doubt := explain_doubt("the roll zero", fit.sd_rad, steps.max_sd_deg):
        raise MeasurementRefusedError(doubt, "insert at more rolls or further, and look at the pictures")
    torsion = measure_torsion(protocol, steps, fit.zero_rad, sight, session)
    return RollZero(protocol.needle.needle_id, fit.zero_rad, fit.sd_rad, session.run_name, torsion)


def _measure_stray_mm(
    protocol: RollZeroSearch, steps: RollZeroSteps, step: int, sight: Sight, session: Session
) -> float:
    """Insert at one roll into a fresh hole, withdraw, and return the lateral deflection of the tip [mm]."""
    advance, rotation = protocol.insertion, session.axis("rotation")
    roll_rad = 2 * math.pi * step / steps.rolls
    session.tell(f"roll zero, {step + 1} of {steps.rolls}")
    session.ask(ShiftToHole(steps.specimen.name, step, step * steps.hole_spacing_mm))
    if steps.torsion is not None:
        session.move("rotation", roll_rad - (math.pi if step % 2 else -math.pi) / 2, rotation.max_speed / 2)
    session.move("rotation", roll_rad, rotation.max_speed / 2)
    session.move("linear", protocol.sheath.depth_mm, protocol.sheath.speed_mm_s)
    origin = _find_sheath(protocol, step, sight, session)
    picture = None
    if origin is None or origin.accepted:
        session.move("insertion", steps.length_mm, advance.speed_mm_s)
        picture = session.take_picture(RollZeroRole.NEEDLE)
    path = (AxisPositions(0.0, roll_rad, protocol.sheath.depth_mm),)
    withdraw(session, path, find_speeds(session.description, advance, protocol.sheath))
    if picture is None:
        reason = "" if origin is None else (origin.reason or "")
        raise MeasurementRefusedError(reason.rstrip("."), "look at sheath, clamp and camera")
    find_bend = partial(sight.find_bend, picture, protocol.needle.diameter_mm, protocol.sheath.diameter_mm)
    return lateral_offset_mm(session.compute(find_bend), origin)


def _find_sheath(protocol: RollZeroSearch, step: int, sight: Sight, session: Session) -> TrialOrigin | None:
    """Find the sheath's pose before the needle leaves it; None if the protocol does not ask for it."""
    if protocol.sheath.origin is None:
        return None
    picture = session.take_picture(RollZeroRole.SHEATH)
    origin = session.compute(partial(sight.find_sheath, picture, protocol.sheath, step))
    session.record(RollZeroSheath(origin=origin))
    return origin
