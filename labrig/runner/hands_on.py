"""How long the person at the rig is busy, learned from the answers of earlier runs."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from labrig.record.events import OperatorQuestion
from labrig.record.reader import Run
from labrig.runner.time_left import GivenAnswer, Workload, find_typical_s


@dataclass(frozen=True)
class HandsOn:
    """The time of the person that a run asks for [s], and from how many answers of how many runs that is known."""

    hands_on_s: float
    answers: int
    runs: int


def list_given_answers(run: Run) -> Iterator[GivenAnswer]:
    """Yield the answers of a run that a person gave; each took as long as passed since the event before it.

    Raises
    ------
    RecordError
        When the events are damaged.
    """
    before_s: float | None = None
    for line in run.lines("events"):
        now_s = float(line["t_s"])
        if line["kind"] == OperatorQuestion.kind and before_s is not None:
            yield GivenAnswer(str(line["request"]), now_s - before_s)
        before_s = now_s


def estimate_hands_on(workload: Workload, runs: Iterable[Sequence[GivenAnswer]]) -> HandsOn | None:
    """Return the time that a person needs for a run by the answers of earlier runs; None if there are none.

    A question takes the median time of the answers of its kind, or of all answers if there are none of its kind.

    Parameters
    ----------
    workload : Workload
        What the run asks.
    runs : iterable of sequence of GivenAnswer
        The answers of each earlier run.
    """
    answered = [answers for answers in runs if answers]
    answers = [answer for given in answered for answer in given]
    if not answers or not workload.operator_steps:
        return None
    overall_s = median(answer.took_s for answer in answers)
    counted = sum(workload.questions.values())
    total_s = sum(
        count * find_typical_s(kind, answers, overall_s) for kind, count in workload.questions.items()
    )
    rest = max(workload.operator_steps - counted, 0)
    return HandsOn(total_s + rest * overall_s, len(answers), len(answered))
