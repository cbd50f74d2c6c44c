"""One needle of a design, as a laser with the protocol's tolerances would cut it: its radius and its reach.

Clearance and inclination are drawn evenly within `tolerances`, which are worst cases, about what equation (3) says to
cut; equations (3) and (1) then give the radius. How far equation (3) itself is off is left out. Nothing is searched.
"""

import math

from labrig.analysis.experiment import TaskOutcome
from labrig.errors import FileFormatError, InputError
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.study import find_problems
from labrig.needle.design_search import design_by_equations
from labrig.needle.equations import EQUATION_3, radius_mm
from labrig.needle.tube import TABLE_1
from labrig.simulation.description import stream

REACH_DEPTH_MM = 20.0
"""Depth at which the reach is stated."""


def simulate(protocol: DesignProtocol, seed: int) -> TaskOutcome:
    """Return the needle of a seed; the same seed gives the same bits in any process.

    Values: clearance_mm and beta_cut_deg as cut, beta_rot_deg, radius_mm, and reach_mm: how far aside of its axis the
    needle is at `REACH_DEPTH_MM` after a single arc, at most a quarter of a circle.

    Raises
    ------
    FileFormatError
        For a design that a run refuses.
    InputError
        For a tube that equation (3) was not fitted to.
    """
    if problems := find_problems(protocol):
        raise FileFormatError(problems)
    tube = protocol.tube
    if not tube.is_papers:
        paper = TABLE_1.tube
        raise InputError(
            f"equation (3) was fitted to a tube of {paper.outer_diameter_mm:g} mm with a bore of "
            f"{paper.inner_diameter_mm:g} mm, and this one has {tube.outer_diameter_mm:g} and "
            f"{tube.inner_diameter_mm:g} mm",
            "make whole runs of the design, which search our own contour",
        )
    designed = design_by_equations(tube, protocol.radius_mm, protocol.clearance_mm)
    draw, within = stream(seed, "cut"), protocol.tolerances
    clearance_mm = protocol.clearance_mm + within.clearance_mm * float(draw.uniform(-1.0, 1.0))
    beta_cut_deg = designed.beta_cut_deg + within.cut_deg * float(draw.uniform(-1.0, 1.0))
    beta_rot_deg = EQUATION_3.beta_rot_deg(beta_cut_deg, clearance_mm)
    cut_radius_mm = radius_mm(beta_rot_deg, tube.link_length_mm)
    values = {
        "clearance_mm": clearance_mm,
        "beta_cut_deg": beta_cut_deg,
        "beta_rot_deg": beta_rot_deg,
        "radius_mm": cut_radius_mm,
        "reach_mm": find_reach_mm(cut_radius_mm),
    }
    return TaskOutcome("success", None, values)


def find_reach_mm(arc_radius_mm: float) -> float:
    """Return how far aside an arc leads to `REACH_DEPTH_MM`; beyond a quarter of a circle it turns back."""
    return arc_radius_mm - math.sqrt(max(arc_radius_mm**2 - REACH_DEPTH_MM**2, 0.0))
