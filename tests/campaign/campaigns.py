"""Campaigns for tests: loaded from files, and computed by a law that a test states."""

import json
import math
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.tasks import LoadedCampaign, Task, load_campaign
from labrig.errors import LabrigError, MachineError

ROOT = Path(__file__).parents[2]
PROTOCOLS, RIGS = ROOT / "protocols", ROOT / "calibration"
Law = Callable[[Task], float | None]


def write_campaign(folder: Path, **keys: object) -> Path:
    """Write a campaign of the example insertion, with these keys, and return its file."""
    path = folder / "campaign-tried.yaml"
    whole = {"campaign": "tried", "base": str(PROTOCOLS / "insertion.yaml"), "seed": 1, **keys}
    path.write_text(json.dumps(whole), encoding="utf-8")
    return path


def load(path: Path, rig: Path | None = RIGS / "rig-simulated.yaml") -> LoadedCampaign:
    """Read a campaign and all that it names."""
    return load_campaign(path, rig=rig)


def computing(law: Law) -> Callable[[Iterable[Task]], Generator[TaskOutcome | LabrigError, None, None]]:
    """Return what computes tasks by a law: a target error, none, or a failure where it is infinite."""

    def compute(tasks: Iterable[Task]) -> Generator[TaskOutcome | LabrigError, None, None]:
        for task in tasks:
            error_mm = law(task)
            if error_mm is not None and math.isinf(error_mm):
                yield MachineError("a process died", "again")
            else:
                reached = error_mm is not None and error_mm <= 2.0
                status, reason = ("success", None) if reached else ("failed", "target_missed")
                yield TaskOutcome(status, reason, {"true_target_error_mm": error_mm, "replans": 3})

    return compute
