"""What `labrig check` tells beside the problems: the person's time, the calibration, what a stop does, what is left."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path

from labrig.cli.output import print_line, print_table, print_wrapped
from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckResult
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription
from labrig.durable import require_free_bytes
from labrig.errors import DiskError, Problem, RecordError
from labrig.record.catalogue import list_runs
from labrig.record.manifest import is_simulated
from labrig.record.reader import open_run
from labrig.runner.experiment import RunPlan
from labrig.runner.hands_on import HandsOn, estimate_hands_on, list_given_answers
from labrig.runner.stop_rehearsal import RehearsedStop, rehearse_stops
from labrig.runner.time_left import GivenAnswer
from labrig.text import format_count

_LEARNED_FROM = 20
"""The newest runs of the experiment on a real rig whose answers are read."""

CHECKED = (
    "keys and values of protocol and rig file, and the files that they name",
    "moves against limits, speeds and currents of the axes",
    "calibration, template and mask against the camera of the rig file",
    "whether target, needle and path lie in the picture",
    "old tracks of named specimens",
    "whether a needle may be in tissue, as the rig remembers",
    "free disk space",
)
RIG_LEFT = (
    "drives and camera (labrig devices check)",
    "whether another labrig holds the rig",
    "answers of the operator",
    "what the first pictures show",
)
NAME_LEFT = ("the name of the run",)


@dataclass(frozen=True)
class CheckReport:
    """What is told of a protocol that could be read."""

    plan: RunPlan
    disk_bytes: int
    rig_name: str | None
    hands_on: HandsOn | None
    calibration: tuple[CheckResult, ...]
    stops: tuple[RehearsedStop, ...]

    @property
    def left_to_run(self) -> tuple[str, ...]:
        """What only the run finds out."""
        return NAME_LEFT if self.rig_name is None else (*RIG_LEFT, *NAME_LEFT)

    def document(self) -> dict[str, object]:
        """Return its keys of the JSON document."""
        return {
            "notes": self.plan.notes,
            "operator_steps": self.plan.operator_steps,
            "hands_on": None if self.hands_on is None else asdict(self.hands_on),
            "calibration": [asdict(result) for result in self.calibration],
            "stops": [asdict(stop) for stop in self.stops],
            "checked": CHECKED,
            "left_to_run": self.left_to_run,
        }


def collect_report(
    plan: RunPlan,
    disk_bytes: int,
    rig: RigDescription | None,
    experiment: str,
    runs_dir: Path,
    now: datetime,
) -> CheckReport:
    """Return what is told of a plan; the person's time is learned from the runs of a folder."""
    if rig is None:
        return CheckReport(plan, disk_bytes, None, None, (), ())
    hands_on = estimate_hands_on(plan.workload, islice(_read_answers(runs_dir, experiment), _LEARNED_FROM))
    ages = tuple(result for result in check_calibration(rig, now) if result.check.endswith(" age"))
    return CheckReport(plan, disk_bytes, rig.name, hands_on, ages, rehearse_stops(plan.moves, rig))


def find_state_warnings(rig: RigDescription | None) -> tuple[Problem, ...]:
    """Return a needle that may be in tissue, as the rig remembers."""
    if rig is None or rig.state_path is None:
        return ()
    state = NeedleState(rig.state_path).state
    return (Problem("rig state", state.doubt, state.find_way_out(rig.option)),) if state.doubt else ()


def find_disk_problems(runs_dir: Path, need_bytes: int) -> tuple[Problem, ...]:
    """Return the disk that is too full for the run."""
    try:
        require_free_bytes(runs_dir, need_bytes)
    except DiskError as error:
        return (Problem("--runs-dir", error.message, error.hint),)
    return ()


def _read_answers(runs_dir: Path, experiment: str) -> Iterator[Sequence[GivenAnswer]]:
    """Yield the answers of each run of an experiment on a real rig, newest first; damaged runs teach nothing."""
    for summary in list_runs(runs_dir):
        if summary.protocol != experiment:
            continue
        try:
            run = open_run(summary.run)
            if not is_simulated(run.manifest):
                yield tuple(list_given_answers(run))
        except RecordError:
            continue


def print_report(report: CheckReport, verdict: str, *, stops: bool) -> None:
    """Print the verdict with the work of the run, the person's time, the age of the calibration, and what is left.

    With `stops` also what a stop does.
    """
    steps = format_count(report.plan.operator_steps, "operator step")
    where = "without a rig" if report.rig_name is None else f"on rig {report.rig_name}"
    print_wrapped(
        f"{verdict} {where}: {report.plan.duration_s / 60:.0f} min of motion, {steps}, "
        f"{format_count(report.plan.pictures, 'picture')}, {report.disk_bytes / 1e6:.0f} MB"
    )
    if report.hands_on is not None:
        learned = format_count(report.hands_on.runs, "earlier run")
        print_wrapped(f"about {report.hands_on.hands_on_s / 60:.0f} min of yours for {steps}, by {learned}")
    elif report.plan.operator_steps and report.calibration:
        print_wrapped(f"how long {steps} take is not known: no run on a real rig has been recorded here")
    for result in report.calibration:
        print_wrapped(f"{result.check}: {result.value}" + (f"; {result.solution}" if result.solution else ""))
    for note in report.plan.notes:
        print_wrapped(note)
    if stops:
        _print_stops(report.stops)
    print_wrapped("not checked here: " + ", ".join(report.left_to_run))


def _print_stops(stops: Sequence[RehearsedStop]) -> None:
    if not stops:
        print_line("nothing moves that could be stopped")
        return
    rows = [
        [
            f"{stop.axis} {stop.start:g} to {stop.end:g}",
            _describe_braking(stop),
            _describe_needle(stop),
            _describe_way(stop),
        ]
        for stop in stops
    ]
    print_table(["stopped during", "goes on for", "needle", "labrig devices withdraw"], rows)
    print_wrapped(
        "A stop halts every axis, then the drives are disabled and the record is closed as aborted. Nothing is "
        "withdrawn by itself. labrig resume keeps the insertions that were made; one that was stopped is made again."
    )


def _describe_braking(stop: RehearsedStop) -> str:
    unit = "rad" if stop.axis == "rotation" else "mm"
    return f"{stop.runs_on:.2g} {unit}, {1e3 * stop.brakes_s:.0f} ms"


def _describe_needle(stop: RehearsedStop) -> str:
    return "in tissue" if stop.in_tissue else "out"


def _describe_way(stop: RehearsedStop) -> str:
    moves = ", ".join(f"{move.axis} to {move.position:g}" for move in stop.withdrawal)
    return f"{moves}: {stop.withdrawal_s:.0f} s" if moves else "nothing"
