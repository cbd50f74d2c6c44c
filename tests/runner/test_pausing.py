"""A person pauses a run: what happens, and what is recorded; `test_any_day` tries what else a person may choose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from labrig.devices.operator import NO_OFFER, Answer, Offer, Operator, OperatorRequest, Paused
from labrig.experiments.declared import find_experiment
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.record.agreement import Verdict
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.dialogue import Dialogue, PauseRequests
from labrig.runner.past import read_past
from labrig.runner.replay import replay_run
from labrig.runner.session import Session
from labrig.runner.trials import is_lost
from tests.runner.sessions import Told, bench, sweep

SHORT = (
    "insertions_per_specimen=2", "sheath.speed_mm_s=15", "insertion.length_mm=5", "insertion.speed_mm_s=5",
    "insertion.withdraw_speed_mm_s=5", "analysis.window_start_mm=0.5", "analysis.window_end_mm=0.5",
    "analysis.min_window_mm=2",
)  # fmt: skip
SPARSE = ("recording.state_rate_hz=2", "can.heartbeat={period_ms: 250, timeout_ms: 1250}")
GO_ON = Answer(confirmed=True, note="c")


@dataclass
class Asks(PauseRequests):
    """Asks for a pause at the first safe point of a kind, once."""

    point: str
    told: list[str] = field(default_factory=list)

    def find(self, point: str) -> str | None:
        """Ask once."""
        if point != self.point:
            return None
        self.point = ""
        return "Ctrl+C"

    def announce(self, when: str) -> None:
        """Remember when the pause will begin."""
        self.told.append(when)


class Patient:
    """Waits at a pause until it is ended from elsewhere."""

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Wait."""
        while True:
            meanwhile()


class Continues(Asks):
    """Ends the pause from elsewhere at once."""

    def find_continuation(self) -> str | None:
        """Ask to continue."""
        return "labrig continue"


@dataclass
class Answers:
    """Gives these answers at pauses; otherwise answers as the operator does."""

    operator: Operator
    answers: list[Answer]
    asked: list[str] = field(default_factory=list)

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer."""
        self.asked.append(request.text)
        if isinstance(request, Paused):
            meanwhile()
            return self.answers.pop(0)
        return self.operator.ask(request, meanwhile)


def make_run(
    tmp_path: Path, answers: Sequence[Answer], *, point: str = "", overrides: Sequence[str] = ()
) -> tuple[Outcome, Run, Answers, Asks]:
    """Make a sweep of two holes with a person who pauses at a point, and answers there."""
    protocol = sweep(*SHORT, *overrides)
    with bench(tmp_path, protocol, SPARSE) as opened:
        rig, asks = opened.opened.rig, Asks(point)
        person = Answers(rig.operator, list(answers))
        rig.operator = rig._person = person
        session = Session(rig, opened.recorder, Told(), Dialogue(asks))
        outcome = conduct(find_experiment(protocol.experiment), protocol, session)
    return outcome, open_run(opened.recorder.path), person, asks


def require_identical(run: Run) -> None:
    """Require that a replay is identical, and that the record is sound."""
    found = replay_run(run, find_run_experiment(run), load_run_protocol(run), Told())
    assert found.verdict is Verdict.IDENTICAL, found.first_difference
    assert check_run(run.path).damage == ()


def test_a_pause_waits_for_the_end_of_the_insertion_and_loses_nothing(tmp_path: Path) -> None:
    """It begins when the needle is out, the axes hold, a person is told, and every insertion is made."""
    outcome, run, person, asks = make_run(tmp_path, [GO_ON], point="trial_end")
    assert outcome.exit_status == "success"
    kinds = [line["kind"] for line in run.lines("events")]
    after = kinds.index("pause")
    assert kinds[after - 1 : after + 3] == ["trial_stop", "pause", "operator", "continue"]
    assert "Paused after this insertion. The axes hold their positions and are supervised." in person.asked
    assert {"at the next question", "after this insertion"} == set(asks.told)
    assert list(run.trials["exit_status"]) == ["success", "success"]
    assert [pause.duration_s for pause in run.pauses] == [0.0]
    require_identical(run)


def test_a_pause_after_an_answer_is_ended_from_elsewhere_before_anything_moves(tmp_path: Path) -> None:
    """`labrig continue` answers for the person at the terminal, which is recorded, and replays."""
    protocol = sweep(*SHORT, "insertions_per_specimen=1")
    with bench(tmp_path, protocol, SPARSE) as opened:
        rig = opened.opened.rig
        rig._person = Patient()
        session = Session(rig, opened.recorder, Told(), Dialogue(Continues("after_answer")))
        outcome = conduct(find_experiment(protocol.experiment), protocol, session)
    assert outcome.exit_status == "success"
    run = open_run(opened.recorder.path)
    lines = [(line["kind"], line.get("answer", line.get("by"))) for line in run.lines("events")]
    paused = [("pause", "Ctrl+C"), ("operator", "labrig continue"), ("continue", "labrig continue")]
    assert lines[1][0] == "operator"
    assert lines[2:5] == paused
    require_identical(run)


def test_a_run_that_is_ended_during_a_pause_is_aborted_and_can_be_resumed(tmp_path: Path) -> None:
    """The insertions so far are kept, and the record says that the pause had no end."""
    outcome, run, _, _ = make_run(tmp_path, [Answer(confirmed=False, note="no")], point="trial_end")
    assert (outcome.exit_status, outcome.reason) == ("aborted", "the operator ended the run during a pause")
    assert [pause.duration_s for pause in run.pauses] == [None]
    assert [is_lost(trial, run.decisions) for trial in read_past(run).begun] == [False]
    require_identical(run)
