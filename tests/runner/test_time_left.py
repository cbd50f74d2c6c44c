"""How much of a run is left."""

import pytest

from labrig.runner.time_left import (
    Elapsed,
    GivenAnswer,
    TimeLeft,
    Workload,
    describe_time_left,
    estimate_time_left,
)

SWEEP = Workload(72 * 54.0, 77, {"MountNeedle": 1, "PlaceSpecimen": 4, "ShiftToHole": 72}, 72)


def test_after_a_tenth_of_a_sweep_the_rest_is_known_within_a_tenth() -> None:
    """A bench that takes 8 % longer than planned, a person who mounts for minutes, and one coffee among the shifts."""
    shifts = [17.0, 21.0, 19.0, 18.0, 600.0, 20.0, 22.0, 19.0]
    answers = [GivenAnswer("MountNeedle", 240.0), GivenAnswer("PlaceSpecimen", 55.0)]
    answers += [GivenAnswer("ShiftToHole", took_s) for took_s in shifts]
    left = estimate_time_left(SWEEP, 8 * 54.0, Elapsed(8 * 54.0, 8 * 54.0 * 1.08), answers)
    assert left.rig_s == pytest.approx(64 * 54.0 * 1.08, rel=0.1)
    assert left.hands_s == pytest.approx(64 * 19.5 + 3 * 55.0, rel=0.1)
    assert left.rig_s is not None
    assert left.hands_s is not None
    assert describe_time_left(left) == (
        f"about {left.hands_s / 60:.0f} minutes of yours and {left.rig_s / 60:.0f} of the rig's left"
    )


def test_a_plan_that_does_not_name_its_questions_goes_by_their_number() -> None:
    """The median of all answers stands for those that are left."""
    answers = [GivenAnswer("A", 10.0), GivenAnswer("B", 30.0), GivenAnswer("C", 20.0)]
    left = estimate_time_left(Workload(100.0, 5), 50.0, Elapsed(50.0, 50.0), answers)
    assert left == TimeLeft(hands_s=40.0, rig_s=50.0)


def test_nothing_is_said_of_what_is_not_known() -> None:
    """Before any answer there is no time of the person, and without a plan none of the rig."""
    assert describe_time_left(estimate_time_left(Workload(), 0.0, Elapsed(0.0, 0.0), [])) == ""
    first = estimate_time_left(SWEEP, 0.0, Elapsed(0.0, 0.0), [])
    assert describe_time_left(first) == "about 65 minutes of the rig's left"
