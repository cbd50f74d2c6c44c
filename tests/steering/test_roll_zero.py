"""The roll zero of a needle from its deflections at several rolls."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError, MeasurementRefusedError
from labrig.steering.roll_zero import correct_perspective, fit_roll_zero
from labrig.vision.out_of_plane import Perspective

RADIUS_MM, LENGTH_MM = 28.0, 20.0
BEND_MM = RADIUS_MM * (1.0 - math.cos(LENGTH_MM / RADIUS_MM))
ROLLS = np.arange(6) * math.pi / 3
OTHERWISE = r"over 20 mm the needle bends by 1\.00 mm; with a radius of 28 mm it would be 6\.84 mm"


@pytest.mark.processors
@given(zero_rad=st.floats(-3.1, 3.1), sheath_mm=st.floats(-1.0, 1.0))
def test_the_zero_is_found_wherever_it_is(zero_rad: float, sheath_mm: float) -> None:
    """Deflections by equation (5) give the zero and the bend back, at any clamping and sheath position."""
    fit = fit_roll_zero(ROLLS, sheath_mm - BEND_MM * np.cos(ROLLS - zero_rad), LENGTH_MM, RADIUS_MM)
    assert math.remainder(fit.zero_rad - zero_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert fit.bend_mm == pytest.approx(BEND_MM)


@given(zero_rad=st.floats(-3.1, 3.1), foot_mm=st.floats(-60.0, 60.0))
def test_where_the_camera_stands_does_not_turn_the_zero(zero_rad: float, foot_mm: float) -> None:
    """A pinhole 200 mm from the plane, above a place beside the needle, sees tips before it and behind it shifted."""
    y_mm, x_mm = -BEND_MM * np.cos(ROLLS - zero_rad), BEND_MM * np.sin(ROLLS - zero_rad)
    seen_mm = foot_mm + (y_mm - foot_mm) * 200.0 / (200.0 + x_mm)
    corrected = correct_perspective(ROLLS, seen_mm, Perspective(np.array((foot_mm, 0.0)), 200.0))
    fit = fit_roll_zero(ROLLS, corrected, LENGTH_MM, RADIUS_MM)
    assert math.remainder(fit.zero_rad - zero_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)


def test_its_standard_deviation_is_that_of_the_zeros_found() -> None:
    """Over 400 noisy repetitions the spread of the zero agrees with the mean of what is stated, within a quarter."""
    rng = np.random.default_rng(1)
    fits = [
        fit_roll_zero(ROLLS, -BEND_MM * np.cos(ROLLS) + rng.normal(0.0, 0.1, 6), LENGTH_MM, RADIUS_MM)
        for _ in range(400)
    ]
    spread = np.std([fit.zero_rad for fit in fits])
    assert spread == pytest.approx(math.sqrt(np.mean([fit.sd_rad**2 for fit in fits])), rel=0.25)


@pytest.mark.parametrize(
    ("rolls", "bend_mm", "error", "words"),
    [
        (ROLLS, 1.0, MeasurementRefusedError, OTHERWISE),
        (ROLLS[:3], BEND_MM, InputError, "3 rolls and 3 deflections"),
    ],
)
def test_what_tells_no_roll_zero_is_refused(rolls, bend_mm, error, words):
    """A straight needle, or one in a far softer gel; and three rolls, which leave no estimate of the uncertainty."""
    with pytest.raises(error, match=words):
        fit_roll_zero(rolls, -bend_mm * np.cos(rolls), LENGTH_MM, RADIUS_MM)
