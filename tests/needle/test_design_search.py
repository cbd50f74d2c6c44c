"""The grid, the plane through it, and the design by search."""

import pytest

from labrig.errors import AnswerIsNoError, InputError
from labrig.needle.design_search import fit_plane, make_hinge_grid, search_design
from labrig.needle.equations import EQUATION_3, RotationPlane
from labrig.needle.hinge import Hinge
from labrig.needle.rotation_search import GridPoint, search_rotations
from labrig.protocol.design_file import PAPER_TUBE


@pytest.fixture(scope="module")
def cells() -> tuple[GridPoint, ...]:
    """Return the corners of the grid."""
    return tuple(map(search_rotations, make_hinge_grid(PAPER_TUBE, 0.025, points=2)))


def test_the_grid_lies_around_the_design() -> None:
    """Of the paper's needle 0.010 to 0.040 mm and 0 to 8 degrees; less where no hinge can be made."""
    hinges = make_hinge_grid(PAPER_TUBE, 0.025)
    assert len(hinges) == 49
    assert (hinges[0].clearance_mm, hinges[0].beta_cut_deg) == (pytest.approx(0.010), 0.0)
    assert (hinges[-1].clearance_mm, hinges[-1].beta_cut_deg) == (pytest.approx(0.040), 8.0)
    assert make_hinge_grid(PAPER_TUBE, 0.08)[-1].clearance_mm < 0.08
    assert make_hinge_grid(PAPER_TUBE, 0.001)[0].clearance_mm == 0.001


@pytest.mark.processors
def test_a_plane_is_found_exactly() -> None:
    """Rotations that lie in a plane give back its numbers and an RMSE of zero."""
    flat = [
        GridPoint(d, cut, EQUATION_3.beta_rot_deg(cut, d) - 1.0, 1.0)
        for d in (0.01, 0.02, 0.03)
        for cut in (0.0, 4.0, 8.0)
    ]
    plane = fit_plane(flat)
    assert (plane.a, plane.b, plane.c) == pytest.approx((EQUATION_3.a, EQUATION_3.b, EQUATION_3.c), abs=1e-9)
    assert plane.rmse_deg == pytest.approx(0.0, abs=1e-9)


def test_our_contour_has_the_form_of_equation_3_but_not_its_slope_with_clearance(
    cells: tuple[GridPoint, ...],
) -> None:
    """Inclination counts about once, as in the paper; clearance counts 10 to 20 % more; the constant is negative."""
    plane = fit_plane(cells)
    assert plane.a == pytest.approx(EQUATION_3.a, abs=0.03)
    assert 1.10 < plane.b / EQUATION_3.b < 1.20
    assert -1.0 < plane.c < EQUATION_3.c


def test_a_searched_design_turns_as_asked(cells: tuple[GridPoint, ...]) -> None:
    """The hinge that is found gives the radius that was asked for."""
    found = search_design(PAPER_TUBE, 30.0, 0.025, fit_plane(cells))
    assert found.beta_rot_deg == pytest.approx(11.459, abs=0.005)
    assert found == search_rotations(Hinge(PAPER_TUBE, 0.025, found.beta_cut_deg))


def test_a_radius_that_no_cut_gives_is_a_no() -> None:
    """The clearance alone turns the hinges too far, whatever the plane promises, or no lips would be left."""
    with pytest.raises(AnswerIsNoError, match="no inclination gives"):
        search_design(PAPER_TUBE, 100.0, 0.025, RotationPlane(1.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="cuts the socket's lips through"):
        search_design(PAPER_TUBE, 8.0, 0.025, EQUATION_3)
