"""The interval of the distance from the target, against draws, and what is decided by it."""

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.steering.arrival import bound_target_error, decide_arrival

CASES = (
    ((0.0, 0.1, 0.05), (0.5, 0.1, 0.1)),
    ((0.0, 1.2, 0.0), (0.3, 0.2, 0.2)),
    ((2.0, 0.3, -0.4), (3.0, 0.05, 0.08)),
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
)


@pytest.mark.parametrize(("offset", "sd"), CASES)
def test_the_interval_holds_95_of_100_draws(offset, sd) -> None:
    """2.5 % of independent draws lie below the interval and 2.5 % above it, whatever the axes."""
    random = np.random.default_rng(6)
    axes = np.linalg.qr(random.standard_normal((3, 3)))[0]
    covariance = axes @ np.diag(np.square(sd)) @ axes.T
    low_mm, high_mm = bound_target_error(offset, covariance)
    apart = np.linalg.norm(random.multivariate_normal(offset, covariance, 400_000), axis=1)
    assert np.mean(apart < low_mm) == pytest.approx(0.025, abs=0.0015)
    assert np.mean(apart > high_mm) == pytest.approx(0.025, abs=0.0015)


def test_what_is_known_has_no_width_and_equal_input_gives_equal_digits() -> None:
    """Without uncertainty the interval is the distance; the same input gives the same digits."""
    assert bound_target_error((0.0, 3.0, 4.0), np.zeros((3, 3))) == (5.0, 5.0)
    covariance = np.diag((0.3, 0.01, 0.02))
    assert bound_target_error((0, 0, 1), covariance) == bound_target_error((0, 0, 1), covariance)


def test_a_part_that_is_not_seen_only_widens_the_interval() -> None:
    """The distance in the plane is the least that it can be: uncertainty out of it raises the upper end."""
    seen = np.diag((0.0, 0.01, 0.01))
    unseen = seen + np.diag((1.0, 0.0, 0.0))
    assert bound_target_error((0, 0, 1), unseen)[1] > bound_target_error((0, 0, 1), seen)[1] + 1


def test_what_is_no_covariance_is_refused() -> None:
    """A matrix that is not symmetric or has a negative variance is refused."""
    with pytest.raises(InputError, match="no covariance"):
        bound_target_error((0, 0, 0), np.diag((1.0, 1.0, -1.0)))
    with pytest.raises(InputError, match="no covariance"):
        bound_target_error((0, 0, 0), np.triu(np.ones((3, 3))))
    with pytest.raises(InputError, match="covariance_mm2 has shape"):
        bound_target_error((0, 0, 0), np.eye(2))


def test_only_an_interval_within_the_tolerance_is_a_success() -> None:
    """Reached where all of the interval is within the tolerance, missed where none of it is."""
    assert decide_arrival((0.1, 1.9), 2.0) == "reached"
    assert decide_arrival((0.1, 2.1), 2.0) == "reached_in_plane_only"
    assert decide_arrival((2.1, 9.0), 2.0) == "missed"
