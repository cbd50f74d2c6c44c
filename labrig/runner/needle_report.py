"""What the person at the rig is told of the needle when a run ends early: motion, place, and what to do."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from labrig.devices.needle_location import NeedleLocation
from labrig.devices.rig import Rig


@dataclass(frozen=True)
class NeedleReport:
    """Where the needle is, and what to do about it; `way_out` is empty if there is nothing to do."""

    location: NeedleLocation
    way_out: str

    def document(self) -> dict[str, object]:
        """Return it ready for JSON."""
        return {**self.location.document(), "way_out": self.way_out or None}


def report_needle(rig: Rig, run: Path) -> NeedleReport:
    """Return the report of the needle of a rig that is still open, at the end of a run."""
    return NeedleReport(rig.locate_needle(), _find_way_out(rig, run))


def _find_way_out(rig: Rig, run: Path) -> str:
    """Return what to do about a needle that is or may be in tissue."""
    if rig.state.needle_in_tissue is False:
        return ""
    if rig.description.kind == "simulated":
        return "the needle is in simulated gel, which is new when the rig is opened again: nothing is to be taken out"
    if rig.state.needle_in_tissue is None:
        return rig.state.find_way_out(rig.description.option)
    since = shlex.quote(str(run.parent / (rig.state.since_run or run.name)))
    return (
        f"leave the drives powered, they keep their positions; the axes hold nothing once labrig has ended. "
        f"Take the needle out along its path: labrig devices withdraw {rig.description.option} --run {since} "
        "(it asks before it resets a fault and before it moves)"
    )
