"""Short runs on a simulated rig, with hooks for faults and answers."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path

from labrig.devices.opening import Opening
from labrig.devices.operator import NO_OFFER, Answer, Offer, Operator, OperatorRequest
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import Problem
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.events import RecordedTrial, TrialStart, TrialStop
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, opening_files, reopen_run
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import RunPlan
from labrig.runner.past import read_past
from labrig.runner.session import Session
from labrig.runner.trials import AnyTrial
from tests.devices.rigs import OpenedRig, large_rig, opened_rig, simulated_rig

PROTOCOLS = Path(__file__).parents[2] / "protocols"
SHORT_WAY = (
    "sheath.depth_mm=2", "analysis.window_start_mm=0", "analysis.window_end_mm=0", "analysis.min_window_mm=5",
)  # fmt: skip
"""What lets a sweep insert a few mm."""
ONE_INSERTION = ("insertions_per_specimen=1", "specimens=[{name: gel-10, gelatin_percent: 10}]")


@cache
def sweep(*overrides: str) -> ExperimentProtocol:
    """Return the sweep of one insertion into one gel."""
    return load_protocol(PROTOCOLS / "steerability.yaml", PROTOCOL_MODELS, [*ONE_INSERTION, *overrides])


@dataclass
class Told:
    """Collects the progress of a run; calls `then` with each sentence."""

    then: Callable[[str], None] = lambda _doing: None
    done: list[float] = field(default_factory=list)

    def __call__(self, done: float, doing: str) -> None:
        """Collect a sentence of progress."""
        self.done.append(done)
        self.then(doing)


@dataclass
class Watched:
    """Passes every request on, then calls `then` with it; declines the kind in `declines`."""

    operator: Operator
    then: Callable[[OperatorRequest], None] = lambda _request: None
    declines: type[object] | tuple[type[object], ...] | None = None
    asked: list[OperatorRequest] = field(default_factory=list)

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer."""
        self.asked.append(request)
        if self.declines is not None and isinstance(request, self.declines):
            return Answer(confirmed=False, note="no")
        answer = self.operator.ask(request, meanwhile)
        self.then(request)
        return answer


@dataclass
class RunBench:
    """An opened rig with its recorder."""

    opened: OpenedRig
    recorder: Recorder
    told: Told = field(default_factory=Told)

    @property
    def session(self) -> Session:
        """The session of a run."""
        return Session(self.opened.rig, self.recorder, self.told)

    def conduct(
        self, protocol: ExperimentProtocol, then: Callable[[str], None] = lambda _doing: None
    ) -> tuple[Outcome, Run]:
        """Conduct a run, calling `then` with each sentence of its progress, and open its record."""
        self.told.then = then
        outcome = conduct(find_experiment(protocol.experiment), protocol, self.session)
        return outcome, open_run(self.recorder.path)

    def resume(self, run: Run, *, anew: bool = True) -> tuple[Outcome, Run]:
        """Go on with a run here, on a rig that was opened anew, and open its record."""
        self.recorder, self.told = reopen_run(run.path, "test"), Told()
        if anew:
            self.recorder.begin_session(self.opened.rig.clock.utc(), devices=self.opened.rig.describe())
        past, protocol = read_past(run), load_run_protocol(run)
        return conduct(find_run_experiment(run), protocol, self.session, past), open_run(run.path)


def begin_record(folder: Path, protocol: ExperimentProtocol, rig: Rig, **manifest: object) -> Recorder:
    """Begin the record of a run on a rig that is open."""
    manifest |= {"experiment": protocol.experiment, "started": rig.clock.utc(), "trials_planned": 1}
    return Recorder.create(folder, "run", manifest, files_of(protocol, rig.description))


_written: dict[str, str] = {}


def files_of(protocol: ExperimentProtocol, rig: RigDescription) -> dict[str, bytes]:
    """Return what a record begins with; a file is written as YAML once: that took a quarter of the fault matrix."""
    texts = []
    for model in (protocol, rig):
        values = repr(model.model_dump(mode="json"))
        if values not in _written:
            _written[values] = dump_yaml(model)
        texts.append(_written[values])
    return opening_files(texts[0], texts[1], rig.calibration_files())


@contextmanager
def bench(
    tmp_path: Path,
    protocol: ExperimentProtocol,
    overrides: Sequence[str] = (),
    *,
    describe: Callable[..., RigDescription] = simulated_rig,
) -> Iterator[RunBench]:
    """Open a simulated rig and a record, as a run has them before power is switched on."""
    opening = Opening(max_current_ma=protocol.current_limits_ma)
    with opened_rig(describe(*overrides), opening=opening) as opened:
        opened.rig.verify()
        devices = opened.rig.describe()
        yield RunBench(opened, begin_record(tmp_path, protocol, opened.rig, devices=devices))


large_bench = partial(bench, describe=large_rig)
"""The same with pictures of 1280x720, for tests of what is measured."""


def plan_of(protocol: ExperimentProtocol, rig: RigDescription | None) -> RunPlan:
    """Return the plan of a protocol's experiment on a rig."""
    return plan_run(find_experiment(protocol.experiment), protocol, rig)


def find_problems(protocol: ExperimentProtocol, rig: RigDescription | None) -> tuple[Problem, ...]:
    """Return the problems of a protocol on a rig."""
    return plan_of(protocol, rig).problems


def record_run(folder: Path, protocol: ExperimentProtocol, *overrides: str) -> Run:
    """Record a run on the simulated rig."""
    with bench(folder, protocol, overrides) as at:
        _, run = at.conduct(protocol)
    return run


def begun(number: int, repeats: int | None, exit_status: str) -> AnyTrial:
    """Return a trial that has ended."""
    start, stop = TrialStart(trial=number, repeats=repeats), TrialStop(trial=number, exit_status=exit_status)
    return RecordedTrial(start, stop)
