"""What `labrig check` tells beside the problems: the calibration, and what only the run finds out."""

from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from labrig.cli.output import print_line
from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckResult
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription
from labrig.durable import require_free_bytes
from labrig.errors import DiskError, Problem
from labrig.runner.experiment import RunPlan
from labrig.text import format_count

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
    calibration: tuple[CheckResult, ...]

    @property
    def left_to_run(self) -> tuple[str, ...]:
        """What only the run finds out."""
        return NAME_LEFT if self.rig_name is None else (*RIG_LEFT, *NAME_LEFT)

    def document(self) -> dict[str, object]:
        """Return its keys of the JSON document."""
        return {
            "notes": self.plan.notes,
            "operator_steps": self.plan.operator_steps,
            "calibration": [asdict(result) for result in self.calibration],
            "checked": CHECKED,
            "left_to_run": self.left_to_run,
        }


def collect_report(plan: RunPlan, disk_bytes: int, rig: RigDescription | None, now: datetime) -> CheckReport:
    """Return what is told of a plan."""
    if rig is None:
        return CheckReport(plan, disk_bytes, None, ())
    ages = tuple(result for result in check_calibration(rig, now) if result.check.endswith(" age"))
    return CheckReport(plan, disk_bytes, rig.name, ages)


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
        return (Problem(str(runs_dir), error.message, error.hint),)
    return ()


def print_report(report: CheckReport, verdict: str) -> None:
    """Print the verdict with the work of the run, the age of the calibration, and what is left."""
    steps = format_count(report.plan.operator_steps, "operator step")
    where = "without a rig" if report.rig_name is None else f"on rig {report.rig_name}"
    print_line(
        f"{verdict} {where}: {report.plan.duration_s / 60:.0f} min of motion, {steps}, "
        f"{format_count(report.plan.pictures, 'picture')}, {report.disk_bytes / 1e6:.0f} MB"
    )
    for result in report.calibration:
        print_line(f"{result.check}: {result.value}" + (f"; {result.solution}" if result.solution else ""))
    for note in report.plan.notes:
        print_line(note)
    print_line("not checked here: " + ", ".join(report.left_to_run))
