"""Checks of a design protocol that need no search."""

from collections.abc import Callable, Iterator

from labrig.errors import AnswerIsNoError, InputError, Problem
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.needle.design_search import design_by_equations
from labrig.needle.equations import EQUATION_3, count_links, radius_tolerance, rotation_for_radius_deg
from labrig.needle.hinge import Hinge
from labrig.needle.tube import Tube

Check = tuple[str, Callable[[], object]]


def find_problems(protocol: DesignProtocol) -> tuple[Problem, ...]:
    """Return the first problem of the equations or of the contour's limits, at its key; empty for a valid design."""
    for key, check in _list_checks(protocol):
        try:
            check()
        except (InputError, AnswerIsNoError) as error:
            return (Problem(key, error.message, error.hint),)
    return ()


def _list_checks(protocol: DesignProtocol) -> Iterator[Check]:
    """Yield each key with its check; later checks assume that the earlier ones passed."""
    yield "tube", lambda: Tube(**protocol.tube.model_dump())
    tube = Tube(**protocol.tube.model_dump())
    yield "clearance_mm", lambda: Hinge(tube, protocol.clearance_mm, 0.0)
    yield "radius_mm", lambda: design_by_equations(tube, protocol.radius_mm, protocol.clearance_mm)
    yield "tolerances", lambda: _require_bounded_radius(protocol, tube)
    if (tip_length_mm := protocol.tip_length_mm) is not None:
        yield "tip_length_mm", lambda: count_links(tip_length_mm, tube.link_length_mm)
    if protocol.measured is not None:
        yield "measured", lambda: _find_effective_clearance_mm(protocol, tube)


def _require_bounded_radius(protocol: DesignProtocol, tube: Tube) -> None:
    found = radius_tolerance(
        EQUATION_3,
        rotation_for_radius_deg(protocol.radius_mm, tube.link_length_mm),
        tube.link_length_mm,
        clearance_tolerance_mm=protocol.tolerances.clearance_mm,
        cut_tolerance_deg=protocol.tolerances.cut_deg,
    )
    if found.high_mm is None:
        raise InputError(
            f"{protocol.tolerances.clearance_mm:g} mm and {protocol.tolerances.cut_deg:g} degrees together may leave "
            "hinges that do not turn at all",
            "give the tolerances of a laser that can cut this needle",
        )


def _find_effective_clearance_mm(protocol: DesignProtocol, tube: Tube) -> float | None:
    measured = protocol.measured
    if measured is None:
        return None
    cut_deg = measured.beta_cut_deg
    if cut_deg is None:
        cut_deg = design_by_equations(tube, protocol.radius_mm, protocol.clearance_mm).beta_cut_deg
    Hinge(tube, protocol.clearance_mm, cut_deg)
    return EQUATION_3.clearance_mm(rotation_for_radius_deg(measured.radius_mm, tube.link_length_mm), cut_deg)
