"""How long a run keeps a person busy, learned from earlier runs."""

from pathlib import Path

from labrig.record.reader import open_run
from labrig.runner.hands_on import estimate_hands_on, list_given_answers
from labrig.runner.time_left import GivenAnswer, Workload
from tests.record.runs import ENDED, begin

_WORK = Workload(operator_steps=12, questions={"ShiftToHole": 10, "MountNeedle": 1})


def test_each_question_takes_the_median_of_its_kind() -> None:
    """What no run has been asked, or the plan does not name, takes the median of all answers."""
    first = [GivenAnswer("ShiftToHole", 30.0), GivenAnswer("ShiftToHole", 40.0)]
    second = [GivenAnswer("ShiftToHole", 900.0)]
    learned = estimate_hands_on(_WORK, [first, [], second])
    assert learned is not None
    assert learned.hands_on_s == 10 * 40.0 + 40.0 + 40.0
    assert (learned.answers, learned.runs) == (3, 2)


def test_nothing_is_said_without_an_answer() -> None:
    """Neither of a run that asks nothing."""
    assert estimate_hands_on(_WORK, [[]]) is None
    assert estimate_hands_on(Workload(), [[GivenAnswer("ShiftToHole", 30.0)]]) is None


def test_an_answer_took_as_long_as_passed_since_the_event_before(tmp_path: Path) -> None:
    """Questions one after another count each for itself."""
    recorder = begin(tmp_path)
    recorder.event("run_start", 1.0)
    recorder.event("operator", 31.0, request="MountNeedle", confirmed=True, answer="", details={})
    recorder.event("operator", 36.0, request="ShiftToHole", confirmed=True, answer="", details={})
    recorder.close("success", "", ENDED)
    answers = list(list_given_answers(open_run(recorder.path)))
    assert answers == [GivenAnswer("MountNeedle", 30.0), GivenAnswer("ShiftToHole", 5.0)]
