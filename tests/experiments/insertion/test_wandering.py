"""An insertion whose needle wanders out of the plane, where the protocol says that it does not."""

from tests.benchmarks.virtual import end_wandering


def test_a_needle_that_wanders_more_than_told_is_seldom_a_false_success() -> None:
    """Of whole insertions that wander six times as much as told and end beyond, at most a tenth says success."""
    ends = [end_wandering(0.3, seed) for seed in range(741_000, 741_008)]
    said = [success for success, beyond in ends if beyond]
    assert len(said) >= 4
    assert sum(said) <= 0.1 * len(said)
