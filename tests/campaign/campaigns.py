"""Campaigns for tests: loaded from files, and computed by a law that a test states."""

import json
import math
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.campaign_file import load_campaign_file
from labrig.campaign.inputs import CampaignFiles, LoadedCampaign, load_campaign
from labrig.campaign.tasks import TaskOrder
from labrig.errors import LabrigError, MachineError

ROOT = Path(__file__).parents[2]
PROTOCOLS, RIGS = ROOT / "protocols", ROOT / "calibration"
Law = Callable[[TaskOrder], float | None]


def write_campaign(folder: Path, **keys: object) -> Path:
    """Write a campaign of the example insertion, with these keys, and return its file."""
    path = folder / "campaign-tried.yaml"
    whole = {"campaign": "tried", "base": str(PROTOCOLS / "insertion.yaml"), "seed": 1, **keys}
    path.write_text(json.dumps(whole), encoding="utf-8")
    return path


def load(path: Path, rig: Path = RIGS / "rig-simulated.yaml") -> LoadedCampaign:
    """Read a campaign and all that it names."""
    content = load_campaign_file(path)
    return load_campaign(CampaignFiles(path, path.parent / content.base, lambda: rig), content)


def computing(law: Law) -> Callable[[Iterable[TaskOrder]], Generator[TaskOutcome | LabrigError, None, None]]:
    """Return what computes tasks by a law: a target error, none, or a failure where it is infinite."""

    def compute(orders: Iterable[TaskOrder]) -> Generator[TaskOutcome | LabrigError, None, None]:
        for order in orders:
            error_mm = law(order)
            if error_mm is not None and math.isinf(error_mm):
                yield MachineError("a process died", "again")
            else:
                reached = error_mm is not None and error_mm <= 2.0
                status, reason = ("success", None) if reached else ("failed", "target_missed")
                yield TaskOutcome(status, reason, {"true_target_error_mm": error_mm, "replans": 3})

    return compute
