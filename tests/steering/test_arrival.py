"""The interval of the distance from the target, against draws, and what is decided by it."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from labrig.steering.arrival import TipOffset, bound_target_error, decide_arrival

DRAWS = 300


def bound(
    offset_mm: ArrayLike, covariance_mm2: ArrayLike, slope: ArrayLike = (0.0, 0.0)
) -> tuple[float, float]:
    """Return the interval of a single offset."""
    offset = TipOffset(np.asarray(offset_mm), np.asarray(covariance_mm2), slope=np.asarray(slope))
    return bound_target_error(offset)


@pytest.mark.parametrize("sd_mm", [(0.5, 0.2, 0.1), (0.05, 0.2, 0.2), (2.0, 0.05, 0.08)])
def test_the_interval_holds_95_of_100_distances(sd_mm: tuple[float, float, float]) -> None:
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


def test_a_needle_steered_to_its_target_may_be_there() -> None:
    """Seen 0.05 mm from the target with 0.06 mm in doubt, a needle may be nearer than 0.02 mm; 0.5 mm not."""
    covariance = np.diag((0.0, 0.06**2, 0.06**2))
    assert bound((0.0, 0.03, 0.04), covariance)[0] < 0.02
    assert bound((0.0, 0.3, 0.4), covariance)[0] > 0.35


def test_what_is_known_has_no_width_and_equal_input_gives_equal_digits() -> None:
    """Without uncertainty the interval is the distance; the same input gives the same digits."""
    assert bound((0.0, 3.0, 4.0), np.zeros((3, 3))) == (5.0, 5.0)
    covariance = np.diag((0.3, 0.01, 0.02))
    assert bound((0, 0, 1), covariance) == bound((0, 0, 1), covariance)


def test_a_part_that_is_not_seen_only_widens_the_interval() -> None:
    """The distance in the plane is the least that it can be: uncertainty out of it raises the upper end."""
    seen = np.diag((0.0, 0.01, 0.01))
    unseen = seen + np.diag((1.0, 0.0, 0.0))
    assert bound((0, 0, 1), unseen)[1] > bound((0, 0, 1), seen)[1] + 1


def test_a_tip_that_may_be_elsewhere_with_a_probability_is_in_the_interval() -> None:
    """With 6 % for a tip three millimetres off, the interval holds it; its variance alone would put it beyond."""
    near, far = np.diag((0.25, 0.01, 0.01)), np.array((3.0, 0.0, 0.0))
    here = TipOffset(np.zeros(3), near, 0.94)
    _, high_mm = bound_target_error(here, TipOffset(far, near, 0.06))
    assert high_mm > 2.8
    mean = 0.06 * far
    variance = near + 0.06 * np.outer(far - mean, far - mean) + 0.94 * np.outer(mean, mean)
    assert bound(mean, variance)[1] < 2.1


def test_only_an_interval_within_the_tolerance_is_a_success() -> None:
    """Reached where all of the interval is within the tolerance, missed where none of it is."""
    assert decide_arrival((0.1, 1.9), 2.0) == "reached"
    assert decide_arrival((0.1, 2.1), 2.0) == "reached_in_plane_only"
    assert decide_arrival((2.1, 9.0), 2.0) == "missed"
