"""Any day at the bench: a person pauses, skips, repeats, marks, takes back and stops, the power fails, and runs go on.

A session waits in a thread of its own at each question, which hypothesis answers as it likes. What the record holds is
compared with a model that knows nothing but what was chosen.
"""

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from labrig.devices.operator import NO_OFFER, Answer, Choice, Offer, OperatorRequest, Paused
from labrig.devices.rig import Rig
from labrig.errors import InterruptedRunError, RecordError
from labrig.experiments.declared import find_experiment
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, reopen_run
from labrig.runner.conduct import Outcome, conduct, conduct_withdrawal
from labrig.runner.past import read_past
from labrig.runner.session import Session
from labrig.runner.trials import is_lost, list_remaining
from tests.devices.rigs import opened_rig, simulated_rig
from tests.runner.sessions import Told, bench, sweep
from tests.runner.test_pausing import SHORT, SPARSE, require_identical

HOLES = 3
PROTOCOL = sweep(*SHORT, f"insertions_per_specimen={HOLES}")
EXPERIMENT = find_experiment(PROTOCOL.experiment)
RIG = simulated_rig(*SPARSE)
PATIENCE_S = 60.0
NO = Answer(confirmed=False, note="no")


class PowerCutError(InterruptedRunError):
    """Ends a session of which only what was on the disk a moment before is used."""


class Sitting:
    """A session in a thread of its own, from its beginning or the record of an interrupted run on."""

    def __init__(self, folder: Path, interrupted: Path | None = None) -> None:
        self.folder = folder
        self.path = folder / "run" if interrupted is None else interrupted
        self.answers: Queue[Answer | None] = Queue()
        self.cut_in: int | None = None
        self.cut: Path | None = None
        self.outcome: Outcome | None = None
        self._asked: Queue[tuple[OperatorRequest, Offer] | None] = Queue()
        self._told = Told(self._note_progress)
        self._made = ThreadPoolExecutor(1).submit(self._make)
        self.question = self._wait()

    def answer(self, answer: Answer | None) -> None:
        """Answer the question, None as the world has it, and wait for the next one, or the end."""
        self.answers.put(answer)
        self.question = self._wait()

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Wait for the answer of the test."""
        self._asked.put((request, offer))
        answer = self.answers.get(timeout=PATIENCE_S)
        return self._hands.ask(request, meanwhile) if answer is None else answer

    def _wait(self) -> tuple[OperatorRequest, Offer] | None:
        asked = self._asked.get(timeout=PATIENCE_S)
        if asked is None:
            self.outcome = self._made.result(PATIENCE_S)
        return asked

    def _note_progress(self, doing: str) -> None:
        if self.cut_in is None:
            return
        self.cut_in -= 1
        if self.cut_in < 0:
            self.cut_in = None
            self.cut = Path(shutil.copytree(self.path, self.folder / f"after {doing}"[:60].replace("/", " ")))
            raise PowerCutError("the power failed")

    def _make(self) -> Outcome:
        try:
            return self._go_on() if self.path.exists() else self._begin()
        finally:
            self._asked.put(None)

    def _begin(self) -> Outcome:
        with bench(self.folder, PROTOCOL, SPARSE) as at:
            return conduct(EXPERIMENT, PROTOCOL, self._sit_down(at.opened.rig, at.recorder))

    def _go_on(self) -> Outcome:
        past = read_past(open_run(self.path))
        with opened_rig(RIG) as opened:
            opened.rig.verify()
            recorder = reopen_run(self.path, "labrig resume")
            recorder.begin_session(opened.rig.clock.utc(), devices=opened.rig.describe())
            return conduct(EXPERIMENT, PROTOCOL, self._sit_down(opened.rig, recorder), past)

    def _sit_down(self, rig: Rig, recorder: Recorder) -> Session:
        self._hands = rig.operator
        rig.operator = rig._person = self
        return Session(rig, recorder, self._told)


class AnyDay(RuleBasedStateMachine):
    """The sessions of one run of three holes."""

    @initialize()
    def begin(self) -> None:
        """Begin the run."""
        self.folder = Path(tempfile.mkdtemp())
        self.chosen: list[Choice] = []
        self.sitting = Sitting(self.folder)
        self.cuts = 0

    def teardown(self) -> None:
        """Make the run to its end: nothing is left, all that was chosen is recorded, and the replay is identical."""
        if not hasattr(self, "sitting"):
            return
        while not self.has_ended:
            if self.sitting.question is None:
                self.go_on()
            else:
                self.agree()
        run = self.open()
        assert list_remaining(range(HOLES), read_past(run).begun, run.decisions) == []
        made = {trial.start.trial: trial for trial in read_past(run).begun}
        kept = [trial for trial in made.values() if not is_lost(trial, run.decisions)]
        assert all(trial.exit_status == "success" for trial in kept)
        assert len(kept) + len(run.decisions.skipped) == HOLES
        require_identical(run)
        shutil.rmtree(self.folder)

    @property
    def has_ended(self) -> bool:
        """Whether the run has come to its end."""
        outcome = self.sitting.outcome
        return self.sitting.question is None and outcome is not None and outcome.exit_status == "success"

    def may(self, choice: Choice) -> bool:
        """Whether that may be chosen now."""
        return self.sitting.question is not None and choice in self.sitting.question[1].choices

    def open(self) -> Run:
        """Open the record as it stands."""
        return open_run(self.sitting.path)

    def choose(self, choice: Choice, text: str = "") -> None:
        """Choose something instead of an answer."""
        self.sitting.answer(Answer(confirmed=False, note=text, choice=choice))

    @precondition(lambda self: self.sitting.question is not None)
    @rule()
    def agree(self) -> None:
        """Say yes."""
        paused = isinstance(self.sitting.question[0], Paused)
        self.sitting.answer(Answer(confirmed=True, note="c") if paused else None)

    @precondition(lambda self: any(map(self.may, (Choice.SKIP, Choice.REPEAT, Choice.MARK_BAD))))
    @rule(data=st.data())
    def decide(self, data: st.DataObject) -> None:
        """Skip, repeat or mark a trial, whatever is offered."""
        offered = [choice for choice in (Choice.SKIP, Choice.REPEAT, Choice.MARK_BAD) if self.may(choice)]
        choice = data.draw(st.sampled_from(offered))
        self.choose(choice, "blurred" if choice is Choice.MARK_BAD else "")
        self.chosen.append(choice)

    @precondition(lambda self: self.may(Choice.NOTE))
    @rule(text=st.text("bubbles é\n", min_size=1, max_size=5).filter(str.strip))
    def note(self, text: str) -> None:
        """Write a note."""
        self.choose(Choice.NOTE, text)
        self.chosen.append(Choice.NOTE)

    @precondition(lambda self: self.may(Choice.UNDO))
    @rule()
    def undo(self) -> None:
        """Take the last choice back."""
        self.choose(Choice.UNDO)
        self.chosen.pop()

    @precondition(lambda self: self.sitting.question is not None)
    @rule()
    def stop(self) -> None:
        """Say no: the run is aborted, and can go on."""
        self.sitting.answer(NO)
        assert self.sitting.outcome is not None
        assert self.sitting.outcome.exit_status == "aborted"

    @precondition(lambda self: self.sitting.question is not None and self.cuts < 2)
    @rule(moves=st.integers(0, 25))
    def cut_the_power(self, moves: int) -> None:
        """Let the power fail on the way to the next question, after so many sentences of progress."""
        self.sitting.cut_in = moves
        self.agree()
        self.sitting.cut_in = None
        if self.sitting.cut is not None:
            self.sitting.path = self.sitting.cut
            self.cuts += 1

    @precondition(lambda self: self.sitting.question is None and not self.has_ended)
    @rule()
    def go_on(self) -> None:
        """Resume the run, which takes out a needle that was left in tissue."""
        self.sitting = Sitting(self.folder, self.sitting.path)

    @precondition(lambda self: self.has_ended)
    @rule()
    def try_to_go_on(self) -> None:
        """A run that has come to its end is not opened again."""
        with pytest.raises(RecordError, match="has come to its end"):
            reopen_run(self.sitting.path, "labrig resume")

    @precondition(lambda self: self.sitting.cut is not None and bool(read_past(self.open()).needle_path))
    @rule()
    def withdraw(self) -> None:
        """Take the needle out along its path, as a run of its own."""
        path = read_past(self.open()).needle_path
        with bench(Path(tempfile.mkdtemp(dir=self.folder)), PROTOCOL, SPARSE) as at:
            outcome = conduct_withdrawal(at.session, "run", path, path[-1])
        assert outcome.exit_status == "success", outcome
        assert check_run(at.recorder.path).damage == ()

    @invariant()
    def holds_what_was_chosen(self) -> None:
        """The record is sound at every question and after every end, and its decisions are those of the person."""
        if not hasattr(self, "sitting"):
            return
        run = self.open()
        assert not run.damage
        assert Counter(made.kind for made in run.decisions.made) == Counter(map(str, self.chosen))


TestAnyDay = AnyDay.TestCase
TestAnyDay.settings = settings(max_examples=12, stateful_step_count=14, deadline=None)
