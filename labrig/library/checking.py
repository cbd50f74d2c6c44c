"""Whether a protocol can run on a rig, how long it takes, and what it needs; nothing moves."""

from dataclasses import asdict, dataclass
from pathlib import Path

from labrig.devices.check_result import CheckResult
from labrig.devices.clocks import SystemClock
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import RigDescription
from labrig.durable import require_free_bytes
from labrig.errors import DiskError, Problem
from labrig.experiments.declared import find_experiment
from labrig.library.calibration_ages import list_calibration_ages
from labrig.library.sources import Sources
from labrig.library.specimens import prepare_specimens
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import RunPlan
from labrig.runner.plan import count_needed_bytes, estimate_disk_bytes

_RIG_LEFT = (
    "drives and camera (labrig devices check)",
    "whether another labrig holds the rig",
    "answers of the operator",
    "what the pictures show, and what is measured in them",
)
_NAME_LEFT = "whether the name of the run is free"


@dataclass(frozen=True)
class Checked:
    """What a dry run tells.

    Attributes
    ----------
    plan : RunPlan
        Trials, duration, pictures, moves, questions.
    disk_bytes : int
        What its record takes.
    rig : RigDescription or None
        The rig; None for an experiment that moves none.
    problems, warnings : tuple of Problem
        Reasons against it, and what is doubtful.
    calibration : tuple of CheckResult
        The age of each file of the rig's calibration.
    """

    plan: RunPlan
    disk_bytes: int
    rig: RigDescription | None
    problems: tuple[Problem, ...]
    warnings: tuple[Problem, ...]
    calibration: tuple[CheckResult, ...]

    @property
    def ok(self) -> bool:
        """Whether it can run."""
        return not self.problems

    @property
    def left_to_run(self) -> tuple[str, ...]:
        """What only the run finds out."""
        return (*(() if self.rig is None else _RIG_LEFT), _NAME_LEFT)

    def document(self) -> dict[str, object]:
        """Return it as JSON."""
        return {
            "ok": self.ok,
            "problems": [asdict(problem) for problem in self.problems],
            "warnings": [asdict(warning) for warning in self.warnings],
            "duration_s": self.plan.duration_s,
            "disk_bytes": self.disk_bytes,
            "operator_steps": self.plan.operator_steps,
            "calibration": [asdict(result) for result in self.calibration],
            "left_to_run": self.left_to_run,
        }


def check_sources(sources: Sources, runs_dir: Path) -> Checked:
    """Plan a run on a virtual rig, and say what speaks against it.

    Raises
    ------
    FileFormatError
        With every problem of protocol and rig file.
    """
    loaded, rig = sources.load()
    experiment, now = find_experiment(loaded.experiment), SystemClock().utc()
    experiment.require_parts()
    specimens = prepare_specimens(loaded, rig, runs_dir, now)
    plan = plan_run(experiment, specimens.protocol, rig)
    refused = plan.problems if plan.refusal is None else (plan.refusal,)
    return Checked(
        plan,
        estimate_disk_bytes(plan, rig),
        rig,
        (*specimens.problems, *refused, *_find_full_disk(runs_dir, count_needed_bytes(plan, rig))),
        (*specimens.warnings, *plan.warnings, *_find_needle_in_tissue(rig)),
        () if rig is None else tuple(list_calibration_ages(rig, now)),
    )


def _find_needle_in_tissue(rig: RigDescription | None) -> tuple[Problem, ...]:
    """Return a needle that may be in tissue, as the rig remembers."""
    if rig is None or rig.state_path is None:
        return ()
    state = NeedleState(rig.state_path).state
    return (Problem("rig state", state.doubt, state.find_way_out(rig.option)),) if state.doubt else ()


def _find_full_disk(runs_dir: Path, needed: int) -> tuple[Problem, ...]:
    try:
        require_free_bytes(runs_dir, needed)
    except DiskError as error:
        return (Problem(str(runs_dir), error.message, error.hint),)
    return ()
