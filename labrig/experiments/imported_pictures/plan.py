"""Imported pictures are already recorded, so their protocol cannot be run."""

from labrig.devices.rig_file import RigDescription
from labrig.errors import Problem
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.runner.experiment import RunPlan


def plan(_protocol: ImportProtocol, _rig: RigDescription | None) -> RunPlan:
    """Return a plan whose problem says why this protocol cannot be run."""
    problem = Problem(
        "experiment",
        "a protocol of imported pictures moves no rig",
        "use labrig import, then labrig reanalyze",
    )
    return RunPlan(problems=(problem,))
