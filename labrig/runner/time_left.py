"""How much of a run is left: the rig's time and that of the person, learned from what has been done of it so far."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median


@dataclass(frozen=True)
class Workload:
    """What a run is going to take, by its plan.

    Attributes
    ----------
    duration_s : float
        Rig time without that of the operator [s]; the unit of `Progress`.
    operator_steps : int
        Requests that the operator answers.
    questions : mapping of str to int
        The same by the class of the request; empty if the plan does not say.
    trials : int
        Trials.
    """

    duration_s: float = 0.0
    operator_steps: int = 0
    questions: Mapping[str, int] = field(default_factory=dict)
    trials: int = 0

    def leave(self, share: float) -> "Workload":
        """Return the work of a person who has this share of it left; the rig's is counted from the start of the run."""
        questions = {kind: math.ceil(share * count) for kind, count in self.questions.items()}
        return replace(self, operator_steps=math.ceil(share * self.operator_steps), questions=questions)


NO_WORKLOAD = Workload()
"""Nothing is known of the run's plan."""


@dataclass(frozen=True)
class GivenAnswer:
    """A question that was answered: the class of the request, and how long the person took [s]."""

    request: str
    took_s: float


@dataclass(frozen=True)
class Elapsed:
    """What has been done so far: in planned seconds, and in seconds of rig time without questions and pauses."""

    planned_s: float
    rig_s: float


@dataclass(frozen=True)
class TimeLeft:
    """What is left for the person and for the rig [s]; None if nothing is known about it."""

    hands_s: float | None
    rig_s: float | None


def estimate_time_left(
    workload: Workload, done_s: float, elapsed: Elapsed, answers: Sequence[GivenAnswer]
) -> TimeLeft:
    """Return what is left of a run.

    The rest of the plan is scaled by how much longer the rig took than planned. A question takes the median time of
    the answers of its kind so far, or of all answers, so that a break at one of them does not count for the others.

    Parameters
    ----------
    workload : Workload
        The plan.
    done_s : float
        How much of `workload.duration_s` is done [s].
    elapsed : Elapsed
        A stretch of the run from which the scale is taken.
    answers : sequence of GivenAnswer
        The answers so far.
    """
    scale = elapsed.rig_s / elapsed.planned_s if elapsed.planned_s > 0 else 1.0
    rig_s = max(workload.duration_s - done_s, 0.0) * scale if workload.duration_s else None
    return TimeLeft(_estimate_hands_s(workload, answers), rig_s)


def _estimate_hands_s(workload: Workload, answers: Sequence[GivenAnswer]) -> float | None:
    if not answers or not workload.operator_steps:
        return None
    given = Counter(answer.request for answer in answers)
    overall_s = median(answer.took_s for answer in answers)
    if not workload.questions:
        return max(workload.operator_steps - len(answers), 0) * overall_s
    return sum(
        max(count - given[kind], 0) * find_typical_s(kind, answers, overall_s)
        for kind, count in workload.questions.items()
    )


def find_typical_s(kind: str, answers: Sequence[GivenAnswer], otherwise_s: float) -> float:
    """Return the median time of the answers to requests of a class [s], or `otherwise_s` if there are none."""
    took_s = [answer.took_s for answer in answers if answer.request == kind]
    return median(took_s) if took_s else otherwise_s


def describe_time_left(left: TimeLeft) -> str:
    """Return what is left in words: `about 52 minutes of yours and 34 of the rig's left`; empty if unknown."""
    if left.hands_s is None:
        return "" if left.rig_s is None else f"about {_format_minutes(left.rig_s)} of the rig's left"
    hands = f"about {_format_minutes(left.hands_s)} of yours"
    return (
        f"{hands} left"
        if left.rig_s is None
        else f"{hands} and {_count_minutes(left.rig_s)} of the rig's left"
    )


def _format_minutes(duration_s: float) -> str:
    minutes = _count_minutes(duration_s)
    return f"{minutes} minute" if minutes == 1 else f"{minutes} minutes"


def _count_minutes(duration_s: float) -> int:
    return round(duration_s / 60)
