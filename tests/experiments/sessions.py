"""Short runs on a simulated rig that a test can disturb behind its back."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from labrig.devices.operator import Answer, Operator, OperatorRequest
from labrig.experiments.conduct import Outcome, conduct
from labrig.experiments.session import Session
from labrig.protocol.load import AnyProtocol, load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record import open_run
from labrig.record.reader import Run
from labrig.record.writer import Recorder
from tests.devices.rigs import OpenedRig, opened_rig, simulated_rig

PROTOCOLS = Path(__file__).parents[2] / "protocols"
ONE_INSERTION = ("insertions_per_specimen=1", "specimens=[{name: gel-10, gelatin_percent: 10}]")


def sweep(*overrides: str) -> AnyProtocol:
    """Return the sweep of one insertion into one gel."""
    return load_protocol(PROTOCOLS / "steerability.yaml", [*ONE_INSERTION, *overrides])


@dataclass
class Told:
    """Progress as it was told; calls `then` with each sentence."""

    then: Callable[[str], None] = lambda _doing: None
    done: list[float] = field(default_factory=list)

    def __call__(self, done: float, doing: str) -> None:
        """Take progress."""
        self.done.append(done)
        self.then(doing)


@dataclass
class Watched:
    """Passes every request on, then calls `then` with it; says no to the kind named in `declines`."""

    operator: Operator
    then: Callable[[OperatorRequest], None] = lambda _request: None
    declines: type[object] | tuple[type[object], ...] | None = None
    asked: list[OperatorRequest] = field(default_factory=list)

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Answer."""
        self.asked.append(request)
        if self.declines is not None and isinstance(request, self.declines):
            return Answer(confirmed=False, note="no")
        answer = self.operator.ask(request, meanwhile)
        self.then(request)
        return answer


@dataclass
class Bench:
    """An opened rig with its recorder."""

    opened: OpenedRig
    recorder: Recorder
    told: Told

    @property
    def session(self) -> Session:
        """The session of a run."""
        return Session(self.opened.rig, self.recorder, self.told)

    def conduct(self, protocol: AnyProtocol) -> tuple[Outcome, Run]:
        """Conduct a run and open its record."""
        outcome = conduct(protocol, self.session)
        return outcome, open_run(self.recorder.path)


@contextmanager
def bench(tmp_path: Path, protocol: AnyProtocol, overrides: Sequence[str] = ()) -> Iterator[Bench]:
    """Open a simulated rig and a record."""
    description = simulated_rig(*overrides)
    with opened_rig(description) as opened:
        opened.rig.connect()
        recorder = Recorder.create(
            tmp_path,
            "run",
            {
                "experiment": protocol.experiment,
                "started": opened.rig.clock.utc(),
                "trials_planned": 1,
                "devices": opened.rig.describe(),
            },
            dump_yaml(protocol),
            dump_yaml(description),
            description.calibration_files(),
        )
        yield Bench(opened, recorder, Told())
