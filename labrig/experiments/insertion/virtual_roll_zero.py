"""The roll zero of a needle as the search of a run would find it in the simulated world, without pictures."""

from labrig.analysis.origin import compare_with_command, lateral_offset_mm
from labrig.devices.needle_state import RollZero
from labrig.errors import InputError, MeasurementRefusedError
from labrig.experiments.insertion.virtual_camera import CalibratedCamera
from labrig.experiments.shared.roll_zero_search import RollZeroOrder, require_sure_zero
from labrig.simulation.world import World
from labrig.steering.roll_zero import fit_roll_zero


def search_roll_zero(order: RollZeroOrder, world: World, camera: CalibratedCamera) -> RollZero:
    """Insert at each roll in the world, fit the cosine, and return its peak; the base is left at the last roll.

    Raises
    ------
    InputError
        When the torsion is to be measured too, which takes pictures.
    MeasurementRefusedError
        When the bend does not fit the needle, or the zero is too uncertain.
    """
    steps = order.steps
    if steps.torsion is not None:
        raise InputError(
            "roll_zero.torsion is measured in pictures, and a virtual run has none",
            "certify the torsion in the rig's state file, or make whole runs on a simulated rig",
        )
    world.place_specimen(steps.specimen.name, steps.specimen.gelatin_percent)
    rolls_rad = order.rolls_rad
    strays_mm = [find_stray_mm(order, step, world, camera) for step in range(steps.rolls)]
    fit = fit_roll_zero(rolls_rad, strays_mm, steps.length_mm, order.radius_mm)
    require_sure_zero(fit, steps)
    return RollZero(order.needle.needle_id, fit.zero_rad, fit.sd_rad, "")


def find_stray_mm(order: RollZeroOrder, step: int, world: World, camera: CalibratedCamera) -> float:
    """Insert at one roll into a fresh hole, withdraw, and return the lateral deflection of the tip [mm]."""
    steps, sheath, roll_rad = order.steps, order.sheath, order.rolls_rad[step]
    world.shift_to_hole(steps.specimen.name, step, step * steps.hole_spacing_mm)
    world.advance(0.0, roll_rad, sheath.depth_mm)
    pose = camera.see_sheath(world)
    origin = None
    if sheath.origin is not None:
        origin = compare_with_command(pose, sheath, sheath.depth_mm, trial=step, frame=step)
    if origin is not None and not origin.accepted:
        raise MeasurementRefusedError((origin.reason or "").rstrip("."), "look at sheath, clamp and camera")
    world.advance(steps.length_mm, roll_rad, sheath.depth_mm)
    end_mm = camera.see_bend(world, pose)
    world.advance(0.0, roll_rad, sheath.depth_mm)
    world.advance(0.0, roll_rad, 0.0)
    return lateral_offset_mm(end_mm, origin)
