"""What an insertion would have been told with other planner, estimator or policy settings: one result beside another.

Both results went the way of the record, picture by picture (see `labrig.analysis.insertion`); here their commands are
compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

_COMMAND = ("roll_rad", "observe_at_mm", "run_to_mm", "stop")


@dataclass(frozen=True)
class CommandDivergence:
    """The first command that differs: after which picture (None: before the first), at which depth, both values."""

    frame: int | None
    depth_mm: float
    what: str
    old: float | str | None
    new: float | str | None


@dataclass(frozen=True)
class SteeringSummary:
    """An insertion as one set of settings tells it: turns asked for, paths found after the first, the first stop.

    `tip_mm` is where the tip is estimated at the last picture, (y, z); None where there is no picture.
    """

    turns: int
    replans: int
    stop: str | None
    tip_mm: tuple[float, float] | None
    turns_at_mm: tuple[float, ...]


@dataclass(frozen=True)
class WhatIf:
    """One insertion as two results tell it; `divergence` is None where both give the same commands throughout."""

    trial: int
    old: SteeringSummary
    new: SteeringSummary
    divergence: CommandDivergence | None


def compare_steering(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[WhatIf, ...]:
    """Compare what two results of an insertion run tell, insertion by insertion.

    Parameters
    ----------
    old, new : Mapping
        Their documents. An insertion that one of them lacks, or of which an older labrig wrote no commands down, is
        left out; so are results of other experiments.
    """
    before = {one["trial"]: one for one in old.get("insertions", ()) if one.get("commands")}
    after = {one["trial"]: one for one in new.get("insertions", ()) if one.get("commands")}
    return tuple(_compared(before[trial], after[trial]) for trial in after if trial in before)


def _compared(old: Mapping[str, Any], new: Mapping[str, Any]) -> WhatIf:
    divergence = _first_divergence(old["commands"], new["commands"])
    return WhatIf(new["trial"], _summarise_steering(old), _summarise_steering(new), divergence)


def summarise_steering(insertion: Mapping[str, Any]) -> SteeringSummary | None:
    """Return what was told in one insertion of a result; None where an older labrig wrote no commands down."""
    return _summarise_steering(insertion) if insertion.get("commands") else None


def _summarise_steering(insertion: Mapping[str, Any]) -> SteeringSummary:
    commands, steps = insertion["commands"], insertion["steps"]
    turns = tuple(one["depth_mm"] for one in commands if one["roll_rad"] != 0.0)
    last, tip = commands[-1], steps[-1]["estimate_mm"] if steps else None
    return SteeringSummary(len(turns), last["replans"], last["stop"], tip and (tip[0], tip[1]), turns)


def _first_divergence(
    old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]
) -> CommandDivergence | None:
    nothing = dict.fromkeys(_COMMAND)
    for before, after in zip_longest(old, new):
        there = after or before
        for what in _COMMAND:
            one, other = (before or nothing)[what], (after or nothing)[what]
            if one != other:
                return CommandDivergence(there["frame"], there["depth_mm"], what, one, other)
    return None
