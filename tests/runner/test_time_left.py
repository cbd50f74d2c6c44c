"""How much of a run is left."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    MountNeedle,
    Offer,
    Operator,
    OperatorRequest,
    ShiftToHole,
)
from labrig.experiments.registry import find_experiment
from labrig.record.events import TrialStop
from labrig.record.reader import open_run
from labrig.runner.conduct import conduct
from labrig.runner.session import Session
from labrig.runner.supervised_record import begin_session
from labrig.runner.time_left import (
    Elapsed,
    GivenAnswer,
    TimeLeft,
    Workload,
    describe_time_left,
    estimate_time_left,
)
from tests.runner.sessions import Told, bench, plan_of, sweep
from tests.runner.test_pausing import SHORT, SPARSE

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


@dataclass
class Unhurried:
    """Takes rig time for each answer, a minute or two to mount, and keeps what was said to be left at each hole."""

    session: Session
    operator: Operator
    draws: random.Random = field(default_factory=lambda: random.Random(5))
    said: list[tuple[float, TimeLeft]] = field(default_factory=list)

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer after a while."""
        clock = self.session.rig.clock
        if isinstance(request, ShiftToHole):
            self.said.append((clock.now_s(), self.session.dialogue.estimate_left()))
        takes_s = 100.0 if isinstance(request, MountNeedle) else self.draws.uniform(15.0, 25.0)
        for _ in range(round(10 * takes_s)):
            clock.sleep(0.1)
            meanwhile()
        return self.operator.ask(request, meanwhile)


def test_a_sweep_says_after_its_first_hole_of_ten_how_long_it_will_take(tmp_path: Path) -> None:
    """The rig's time and the person's are known within a tenth, by the clock of the rig."""
    protocol = sweep(*SHORT, "insertions_per_specimen=10")
    with bench(tmp_path, protocol, SPARSE) as at:
        rig, workload = at.opened.rig, plan_of(protocol, at.opened.rig.description).workload
        session = begin_session(rig, lambda: at.recorder, Told(), workload)
        person = rig.operator = Unhurried(session, rig.operator)
        conduct(find_experiment(protocol.experiment), protocol, session)
    asked_s, left = person.said[1]
    assert left.hands_s is not None
    assert left.rig_s is not None
    truly_s = open_run(at.recorder.path).read_events(TrialStop)[-1].t_s - asked_s
    assert left.hands_s + left.rig_s == pytest.approx(truly_s, rel=0.1)


def test_a_plan_that_does_not_name_its_questions_goes_by_their_number() -> None:
    """The median of all answers stands for those that are left."""
    answers = [GivenAnswer("A", 10.0), GivenAnswer("B", 30.0), GivenAnswer("C", 20.0)]
    left = estimate_time_left(Workload(100.0, 5), 50.0, Elapsed(50.0, 50.0), answers)
    assert left == TimeLeft(hands_s=40.0, rig_s=50.0)


def test_a_resumed_run_has_a_share_of_its_questions_left() -> None:
    """The person's work is that of the remaining trials, each kind rounded up."""
    left = SWEEP.leave(10 / 72)
    assert left.questions == {"MountNeedle": 1, "PlaceSpecimen": 1, "ShiftToHole": 10}
    assert (left.operator_steps, left.duration_s) == (11, SWEEP.duration_s)


def test_nothing_is_said_of_what_is_not_known() -> None:
    """Before any answer there is no time of the person, and without a plan none of the rig."""
    assert describe_time_left(estimate_time_left(Workload(), 0.0, Elapsed(0.0, 0.0), [])) == ""
    first = estimate_time_left(SWEEP, 0.0, Elapsed(0.0, 0.0), [])
    assert describe_time_left(first) == "about 65 minutes of the rig's left"
