"""The interval of the distance from the target, against draws, and what is decided by it."""

import numpy as np
import pytest

from labrig.steering.arrival import TipOffset, bound_target_error, decide_arrival

DRAWS = 200


def bound(offset_mm, covariance_mm2, slope=(0.0, 0.0)):
    """Return the interval of a single offset."""
    return bound_target_error(TipOffset(np.asarray(offset_mm), covariance_mm2, slope=np.asarray(slope)))


@pytest.mark.parametrize("sd_mm", [(0.5, 0.2, 0.1), (0.05, 0.2, 0.2), (2.0, 0.05, 0.08)])
def test_the_interval_holds_95_of_100_distances(sd_mm):
    """Of needles that the line of sight passes at any distance, the interval holds 95 %, and the rest on both sides."""
    random, ray = np.random.default_rng(6), np.array((1.0, 0.3, -0.2))
    covariance = np.diag((0.0, *np.square(sd_mm[1:]))) + sd_mm[0] ** 2 * np.outer(ray, ray)
    below = above = 0
    for _ in range(DRAWS):
        angle, x_mm = random.uniform(0.0, 2 * np.pi), random.normal(0.0, sd_mm[0])
        passed_mm = random.uniform(0.0, 1.0) * np.array((0.0, np.cos(angle), np.sin(angle)))
        seen_mm = passed_mm + random.normal(0.0, (0.0, *sd_mm[1:]))
        low_mm, high_mm = bound(seen_mm, covariance, ray[1:])
        true_mm = np.linalg.norm(passed_mm + x_mm * ray)
        below += int(true_mm < low_mm)
        above += int(true_mm > high_mm)
    assert 0.92 <= 1 - (below + above) / DRAWS <= 0.98
    assert 0.005 <= above / DRAWS <= 0.05


def test_only_the_doubt_widens_the_interval():
    """What is known has no width; 0.05 mm with 0.06 mm in doubt may be nearer than 0.02 mm, 0.5 mm not.

    The distance in the plane is the least that it can be: uncertainty out of it raises the upper end alone.
    """
    assert bound((0.0, 3.0, 4.0), np.zeros((3, 3))) == (5.0, 5.0)
    covariance = np.diag((0.0, 0.06**2, 0.06**2))
    assert bound((0.0, 0.03, 0.04), covariance)[0] < 0.02
    low_mm, high_mm = bound((0.0, 0.3, 0.4), covariance)
    assert low_mm > 0.35
    assert bound((0.0, 0.3, 0.4), covariance + np.diag((1.0, 0.0, 0.0)))[1] > high_mm + 1


def test_a_tip_that_may_be_elsewhere_with_a_probability_is_in_the_interval():
    """With 6 % for a tip three millimetres off, the interval holds it; its variance alone would put it beyond."""
    near, far = np.diag((0.25, 0.01, 0.01)), np.array((3.0, 0.0, 0.0))
    assert bound_target_error(TipOffset(np.zeros(3), near, 0.94), TipOffset(far, near, 0.06))[1] > 2.8
    mean = 0.06 * far
    variance = near + 0.06 * np.outer(far - mean, far - mean) + 0.94 * np.outer(mean, mean)
    assert bound(mean, variance)[1] < 2.1


def test_only_an_interval_within_the_tolerance_is_a_success():
    """Reached where all of the interval is within the tolerance, missed where none of it is."""
    assert decide_arrival((0.1, 2.0), 2.0) == "reached"
    assert decide_arrival((2.0, 2.1), 2.0) == "reached_in_plane_only"
    assert decide_arrival((2.1, 9.0), 2.0) == "missed"
