"""The search for the largest rotation, against brute force."""

import numpy as np
import pytest

from labrig.needle.hinge import Hinge, HingeView, widest_clearance_mm
from labrig.needle.rotation_search import (
    FreeRotation,
    interference_mm2,
    search_largest_rotation,
    search_rotations,
)
from labrig.protocol.design_file import PAPER_TUBE
from tests.needle.no_fit import NoFit, make_tube

PAPER = Hinge(PAPER_TUBE, 0.025, 4.13)


def random_hinge(number: int) -> Hinge:
    """Return one of the random designs: tubes of 0.8 to 2 mm, clearances and inclinations over most that they allow."""
    rng = np.random.default_rng(number)
    outer_mm = rng.uniform(0.8, 2.0)
    tube = make_tube(outer_mm, outer_mm * rng.uniform(0.5, 0.75), 3 * outer_mm)
    beta_cut_deg = rng.uniform(0.0, 10.0)
    return Hinge(tube, rng.uniform(0.1, 0.9) * widest_clearance_mm(tube, beta_cut_deg), beta_cut_deg)


def as_pose(found: FreeRotation) -> np.ndarray:
    """Return the pose that was found, as `interference_mm2` takes it."""
    return np.array([found.rotation_deg, found.lateral_mm, found.axial_mm])


@pytest.mark.parametrize("pin", ["a", "b"])
@pytest.mark.parametrize(
    "number", [0, 1, 2, *(pytest.param(n, marks=pytest.mark.slow) for n in range(3, 10))]
)
def test_the_search_finds_the_true_maximum(number: int, pin: str) -> None:
    """Brute force finds no free angle 0.02 and 0.03 degrees beyond it, nor at coarser steps to the end of the box."""
    hinge = random_hinge(number)
    view = hinge.hinge_a() if pin == "a" else hinge.hinge_b()
    found = search_largest_rotation(view)
    assert interference_mm2(view, as_pose(found)) == 0.0
    no_fit = NoFit(view)
    beyond = np.linspace(found.rotation_deg + 0.02, view.box.rotation_deg, 12)
    assert not any(no_fit.is_free(angle) for angle in (*beyond, found.rotation_deg + 0.03))


def test_brute_force_agrees_with_the_shared_area() -> None:
    """The brute force of these tests calls free what has a pose without shared area, and only that."""
    view = PAPER.hinge_b()
    no_fit = NoFit(view)
    rng = np.random.default_rng(5)
    for angle in np.linspace(0.5, view.box.rotation_deg, 8):
        lateral = rng.uniform(-view.box.lateral_mm, view.box.lateral_mm, 4000)
        axial = rng.uniform(-view.box.axial_mm, view.box.axial_mm, 4000)
        some_free = bool(
            (interference_mm2(view, np.array([np.full(4000, angle), lateral, axial])) == 0.0).any()
        )
        assert no_fit.is_free(angle) or not some_free


def test_rotation_grows_with_clearance_and_inclination() -> None:
    """A wider cut, or a steeper one, never turns less, beyond the search's thousandth of a degree."""
    narrow, middle, wide = (search_rotations(Hinge(PAPER_TUBE, d, 4.0)) for d in (0.005, 0.025, 0.06))
    straight, steep = (search_rotations(Hinge(PAPER_TUBE, 0.025, cut)) for cut in (0.0, 12.0))
    for found in ((narrow, middle, wide), (straight, middle, steep)):
        assert all(np.diff([rotation.beta_a_deg for rotation in found]) > 0.005)
        assert all(np.diff([rotation.beta_b_deg for rotation in found]) > 0.005)


@pytest.mark.parametrize("beta_cut_deg", [1.0, pytest.param(4.0, marks=pytest.mark.slow), 8.0])
def test_without_clearance_hinge_a_turns_by_the_inclination(beta_cut_deg: float) -> None:
    """As d goes to zero, hinge a turns by beta_cut and hinge b not at all."""
    finest, finer = (search_rotations(Hinge(PAPER_TUBE, d, beta_cut_deg)) for d in (0.001, 0.002))
    assert 2 * finest.beta_a_deg - finer.beta_a_deg == pytest.approx(beta_cut_deg, abs=0.01)
    assert 2 * finest.beta_b_deg - finer.beta_b_deg == pytest.approx(0.0, abs=0.005)


def test_the_same_seed_gives_the_same_answer_and_another_one_no_other() -> None:
    """The search repeats to the bit, and no seed changes the rotation by 0.005 degrees."""
    first, again, other = (search_largest_rotation(PAPER.hinge_a(), seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert other.rotation_deg == pytest.approx(first.rotation_deg, abs=0.005)


@pytest.mark.processors
@pytest.mark.parametrize("view", [PAPER.hinge_a(), PAPER.hinge_b()], ids=["a", "b"])
def test_the_box_does_not_hold_the_search(view: HingeView) -> None:
    """The maximum lies well inside the box, but for the play of hinge b along its pin, which is a limit itself."""
    found = search_largest_rotation(view)
    assert found.rotation_deg < 0.8 * view.box.rotation_deg
    assert abs(found.axial_mm) < 0.8 * view.box.axial_mm
    assert abs(found.lateral_mm) <= view.box.lateral_mm
