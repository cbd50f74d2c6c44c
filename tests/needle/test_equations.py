"""Equations (1) to (3), their inverses and tolerances."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import AnswerIsNoError, InputError
from labrig.needle.equations import (
    EQUATION_3,
    RotationPlane,
    radius_mm,
    radius_tolerance,
    rotation_for_radius_deg,
)
from labrig.needle.tube import TABLE_1

CUTS_DEG = st.floats(0.0, 20.0)
CLEARANCES_MM = st.floats(0.001, 0.08)


def test_the_equations_give_the_papers_numbers() -> None:
    """Table I: 30 mm from links of 3 mm are 11.46 degrees, and 4.12 of inclination by equation (3), printed as 4.13.

    The measured mean of 27.6 mm means 12.46 degrees and an effective clearance of 0.0283 mm.
    """
    beta_rot_deg = rotation_for_radius_deg(TABLE_1.radius_mm, TABLE_1.tube.link_length_mm)
    beta_cut_deg = EQUATION_3.beta_cut_deg(beta_rot_deg, TABLE_1.clearance_mm)
    assert (round(beta_rot_deg, 2), round(beta_cut_deg, 2)) == (11.46, 4.12)
    assert beta_cut_deg == pytest.approx(TABLE_1.beta_cut_deg, abs=0.01)
    measured_deg = rotation_for_radius_deg(27.6, 3.0)
    assert round(measured_deg, 2) == 12.46
    assert round(EQUATION_3.clearance_mm(measured_deg, TABLE_1.beta_cut_deg), 4) == 0.0283


@given(beta_cut_deg=CUTS_DEG, clearance_mm=CLEARANCES_MM)
def test_a_plane_and_its_inverses_undo_each_other(beta_cut_deg: float, clearance_mm: float) -> None:
    """Solving a plane for the inclination or the clearance, and a radius for its rotation, gives back what went in."""
    plane = RotationPlane(1.09, 296.0, 0.0, 0.0)
    beta_rot_deg = plane.beta_rot_deg(beta_cut_deg, clearance_mm)
    assert plane.beta_cut_deg(beta_rot_deg + 1e-9, clearance_mm) == pytest.approx(beta_cut_deg, abs=1e-6)
    assert plane.clearance_mm(beta_rot_deg + 1e-9, beta_cut_deg) == pytest.approx(clearance_mm, abs=1e-6)
    bent_mm = 4.0 + 499.0 * beta_cut_deg
    assert radius_mm(rotation_for_radius_deg(bent_mm, 3.0), 3.0) == pytest.approx(bent_mm, rel=1e-12)


@given(beta_cut_deg=st.floats(2.0, 15.0), clearance_mm=st.floats(0.01, 0.05))
def test_slopes_are_those_of_the_radius(beta_cut_deg: float, clearance_mm: float) -> None:
    """The slopes agree with central differences of equations (1) and (3); the ends have its rms residual twice."""
    beta_rot_deg = EQUATION_3.beta_rot_deg(beta_cut_deg, clearance_mm)
    found = radius_tolerance(
        EQUATION_3, beta_rot_deg, 3.0, clearance_tolerance_mm=0.003, cut_tolerance_deg=0.1
    )

    def radius(cut_deg: float, d_mm: float) -> float:
        return radius_mm(EQUATION_3.beta_rot_deg(cut_deg, d_mm), 3.0)

    for slope, step_deg, step_mm in ((found.per_clearance, 0.0, 1e-6), (found.per_degree_mm, 1e-4, 0.0)):
        ends = [radius(beta_cut_deg + side * step_deg, clearance_mm + side * step_mm) for side in (1, -1)]
        assert slope == pytest.approx((ends[0] - ends[1]) / 2 / (step_deg + step_mm), rel=1e-5)
    off_deg = 0.1 + 2 * 0.1608 / EQUATION_3.a
    assert found.low_mm == pytest.approx(radius(beta_cut_deg + off_deg, clearance_mm + 0.003))
    assert found.high_mm == pytest.approx(radius(beta_cut_deg - off_deg, clearance_mm - 0.003))


def test_the_laser_moves_the_papers_radius_by_millimetres() -> None:
    """A laser 0.003 mm off turns 30 mm into 27.8 to 32.5, the fit's error into 29.2 to 30.9; no turn, no upper end."""
    exact = replace(EQUATION_3, rmse_deg=0.0)
    for plane, laser_mm, ends in ((exact, 0.003, (27.8, 32.5)), (EQUATION_3, 0.0, (29.2, 30.9))):
        found = radius_tolerance(plane, 11.459, 3.0, clearance_tolerance_mm=laser_mm, cut_tolerance_deg=0.0)
        assert (round(found.low_mm, 1), round(found.high_mm or math.nan, 1)) == ends
    open_ended = radius_tolerance(EQUATION_3, 0.9, 3.0, clearance_tolerance_mm=0.003, cut_tolerance_deg=0.1)
    assert open_ended.high_mm is None


def test_what_clearance_or_inclination_alone_exceeds_is_a_no() -> None:
    """The hinges turn further already: no inclination gives the radius, and no clearance explains it."""
    with pytest.raises(AnswerIsNoError, match=r"0\.025 mm alone allows 6\.967"):
        EQUATION_3.beta_cut_deg(rotation_for_radius_deg(200.0, 3.0), 0.025)
    with pytest.raises(AnswerIsNoError, match="no clearance gives"):
        EQUATION_3.clearance_mm(rotation_for_radius_deg(200.0, 3.0), 4.13)


@pytest.mark.parametrize(
    ("radius", "message"),
    [(0.03, "at least 3.82 mm"), (30_000.0, "at most 1e+04 mm"), (-30.0, "at least"), (math.nan, "nan")],
)
def test_impossible_radii_are_refused(radius: float, message: str) -> None:
    """A radius beyond its limits is refused with the limit."""
    with pytest.raises(InputError, match=message.replace("+", r"\+")) as refused:
        rotation_for_radius_deg(radius, 3.0)
    assert "give a value from" in refused.value.hint
