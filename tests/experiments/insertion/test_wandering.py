"""An insertion whose needle wanders out of the plane, where the protocol says that it does not."""

from tests.benchmarks.wandering import TOLERANCE_MM, insert_wandering


def test_a_needle_that_wanders_more_than_told_is_seldom_a_false_success() -> None:
    """Of whole insertions that wander six times as much as told and end beyond, at most a tenth says success."""
    ends = [insert_wandering(0.3, seed) for seed in range(741_000, 741_008)]
    beyond = [status for status, error_mm in ends if error_mm is not None and error_mm > TOLERANCE_MM]
    assert len(beyond) >= 4
    assert beyond.count("success") <= 0.1 * len(beyond)
